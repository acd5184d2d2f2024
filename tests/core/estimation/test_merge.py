"""Merging: the table is the same after any order, loss with repair, repetition or loop; nonsense changes nothing."""

import math
from random import Random

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.core.estimation.evidence_table import FIRST, INCARNATIONS, Bounds, Table, entry_fault, floored
from agent.core.estimation.fuse import fuse
from agent.core.estimation.interface import Prior
from agent.core.linear_algebra import plus, times
from agent.core.link_clocks import CLOCKS_NS
from agent.core.messages import Entry

BOUNDS = Bounds(frozenset({"r1", "r2", "r3"}), (1.5, 1.2, 0.8), 1_000_000_000)
COV = (1e-4, 0.0, 0.0, 4e-4, 1e-5, 1e-4)
B = (1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6)


def take(table: Table, entry: Entry, now_ns: int = 0) -> tuple[bool, str | None]:
    """What a robot does with a neighbour's entry: (whether it was news, what is wrong with it)."""
    if not table.is_news(entry):
        return False, None
    fault = entry_fault(entry, BOUNDS, now_ns)
    return (False, fault) if fault is not None else (True, table.merge(entry))


def prior(x: float) -> Prior:
    return Prior((x, 0.5, 0.1), COV, 0, B)


def history() -> list[Entry]:
    """Every version that three robots, one of them started twice, ever said."""
    said, random = [], Random(3)
    for key in (("r1", 1), ("r2", 5), ("r2", 6), ("r3", 1)):
        table = Table()
        for _ in range(4):
            table.measure(key, prior(0.7 + random.gauss(0.0, 0.01)))
            said.append(table.entries[key])
    return said


SAID = history()
LATEST = {(e.origin, e.incarnation): e for e in SAID}


@given(st.permutations(SAID), st.lists(st.sampled_from(SAID), max_size=20))
@settings(max_examples=100, deadline=None)
def test_any_order_and_any_repetition_end_in_the_same_table(order, repeated) -> None:
    table = Table()
    for entry in [*repeated, *order, *repeated]:
        _, fault = take(table, entry)
        assert fault is None
    assert table.entries == LATEST
    reference = Table()
    for entry in SAID:
        take(reference, entry)
    assert table.opinions() == reference.opinions(), "to the last bit"


def joined(*tables: Table) -> Table:
    """One table after it was told all that the tables hold, in their order."""
    found = Table()
    for table in tables:
        for entry in table.entries.values():
            take(found, entry)
    return found


tables = st.lists(st.sampled_from(SAID), max_size=12)


@given(tables, tables, tables)
@settings(max_examples=100, deadline=None)
def test_joining_tables_is_commutative_associative_and_idempotent(first, second, third) -> None:
    a, b, c = (Table() for _ in range(3))
    for table, entries in zip((a, b, c), (first, second, third), strict=True):
        for entry in entries:
            take(table, entry)
    assert joined(a, b).entries == joined(b, a).entries
    assert joined(joined(a, b), c).entries == joined(a, joined(b, c)).entries
    assert joined(a, a).entries == a.entries
    assert joined(a, b).opinions() == joined(b, a).opinions(), "to the last bit"


@given(st.lists(st.integers(1, 5), min_size=1, max_size=INCARNATIONS), st.integers(0, 2**32))
@settings(max_examples=60, deadline=None)
def test_restarts_split_the_sum_and_lose_nothing(lives, seed) -> None:
    """A robot that measures under several incarnations says what one that never stopped says, from when on it has
    measured as much as in the longest life before."""
    lives.sort()
    whole, split, random = Table(), Table(), Random(seed)
    for incarnation, count in enumerate(lives):
        for _ in range(count):
            sample = prior(0.7 + random.gauss(0.0, 0.01))
            whole.measure(("r1", 0), sample)
            split.measure(("r1", incarnation), sample)
    (one,), (other,) = whole.opinions(), split.opinions()
    assert other.x_m == pytest.approx(one.x_m, abs=1e-12)
    assert other.cov_m2 == pytest.approx(one.cov_m2, rel=1e-9)


def test_a_repeat_is_no_news() -> None:
    table = Table()
    assert take(table, SAID[2]) == (True, None)
    assert take(table, SAID[2]) == (False, None)
    assert take(table, SAID[1]) == (False, None)


def test_the_systematic_error_enters_once_however_many_samples_and_starts() -> None:
    table = Table()
    for key in (("r1", 1), ("r1", 2)):
        for _ in range(5):
            table.measure(key, prior(0.7))
    (only,) = table.opinions()
    assert only.cov_m2 == pytest.approx(plus(times(0.1, COV), B))


def test_a_robot_that_restarts_all_day_does_not_fill_the_memory() -> None:
    table = Table()
    for start in range(100):
        take(table, msgspec.structs.replace(SAID[0], incarnation=start))
    assert sorted(e for _, e in table.entries) == list(range(100 - INCARNATIONS, 100))


GOOD = SAID[3]
NAN = math.nan


@pytest.mark.parametrize(
    ("why", "changes"),
    [
        ("not finite", {"information": (NAN, 0.0, 0.0, 1.0, 0.0, 1.0)}),
        ("not finite", {"vector": (math.inf, 0.0, 0.0)}),
        ("not a covariance", {"information": times(-1.0, GOOD.information)}),
        ("not a covariance", {"systematic_m2": (1.0, 2.0, 0.0, 1.0, 0.0, 1.0)}),
        ("unknown origin", {"origin": "r9"}),
        ("too sure", {"information": times(1e6, GOOD.information), "vector": tuple(1e6 * v for v in GOOD.vector)}),
        ("outside the tank", {"vector": tuple(10.0 * v for v in GOOD.vector)}),
        ("too many samples", {"count": round(1.25 * CLOCKS_NS / BOUNDS.iteration_ns) + FIRST + 1}),
        ("from the future", {"incarnation": CLOCKS_NS + 1}),
    ],
)
def test_nonsense_is_refused_by_name_and_changes_nothing(why, changes) -> None:
    table = Table()
    take(table, GOOD)
    before = dict(table.entries)
    bad = msgspec.structs.replace(GOOD, **{"count": GOOD.count + 1, **changes})
    assert take(table, bad) == (False, why)
    assert table.entries == before
    assert take(table, msgspec.structs.replace(GOOD, count=GOOD.count + 1)) == (True, None)


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=15, max_size=15), st.integers(1, 2**63))
@settings(max_examples=200, deadline=None)
def test_garbage_never_breaks_the_fusion(numbers, count) -> None:
    table = Table()
    take(table, GOOD)
    take(table, Entry("r2", 9, count, tuple(numbers[:6]), tuple(numbers[6:9]), tuple(numbers[9:])))
    fused = fuse(table.opinions())
    assert all(map(math.isfinite, (*fused.x_m, *fused.cov_m2)))


def test_vision_that_is_too_sure_is_floored() -> None:
    assert floored((1e-9, 0.0, 0.0, 1e-4, 0.0, 1e-4))[0] >= 1e-6
    assert floored(COV) == COV
