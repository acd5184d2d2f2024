"""One word for what a robot believes: raised at once, lowered after five seconds, with its cause in words."""

import math

import pytest

from agent.core.messages import Explain
from agent.core.verdict import FEWEST, FEWEST_SWEEPS, KEEPS_NS, Consistency, Ratio

S = 10**9


def told(consistency: Consistency, s: float) -> tuple[str, str]:
    word, causes = consistency.verdict(round(s * S))
    return word, causes[0] if causes else ""


def test_a_word_is_raised_at_once_and_lowered_five_seconds_after_its_cause() -> None:
    found = Consistency("r1")
    assert told(found, 1.0) == ("consistent", "")
    found.update(Explain(status="ambiguous"), False, S)
    assert told(found, 1.0)[0] == "contradicted"
    assert told(found, 1.0 + KEEPS_NS / S)[0] == "contradicted"
    assert told(found, 1.1 + KEEPS_NS / S) == ("consistent", "")


def test_the_worst_cause_stands_first() -> None:
    found = Consistency("r1")
    found.update(Explain(status="outlier", doubted={"r2": 0.0}, moved_m=(0.0, 0.06, 0.0)), False, S)
    found.missed({"r1": 4.0, "r2": 4.0}, (), -8 * S, S)
    word, causes = found.verdict(S)
    assert word == "missing"
    assert causes[0] == "not seen where it was by r1, r2"
    assert any("may have moved by 60 mm" in cause for cause in causes)
    assert any(cause.startswith("r2 stands apart") for cause in causes)


@pytest.mark.parametrize(
    ("nats", "sees", "unseen_s", "word"),
    [
        ({"r1": 4.0, "r2": 4.0}, [], 7.9, "consistent"),
        ({"r1": 4.0, "r2": 4.0}, [], 8.0, "missing"),
        ({"r1": 4.0, "r2": 0.0}, [], 8.0, "suspect"),
        ({"r1": 4.0, "r2": 0.0}, [], 20.0, "missing"),
        ({"r1": 2.0, "r2": 2.0}, [], 60.0, "consistent"),
        ({"r1": 4.0, "r2": 4.0, "r3": 0.0}, ["r3"], 0.0, "contradicted"),
        ({"r1": 4.0, "r2": 4.0, "r3": 0.0}, ["r1"], 0.0, "consistent"),
    ],
)
def test_who_looks_where_it_was_and_does_not_see_it(nats, sees, unseen_s, word) -> None:
    found = Consistency("r1")
    found.missed(nats, sees, 0, round(unseen_s * S))
    assert told(found, unseen_s)[0] == word


@pytest.mark.parametrize(("by", "word"), [(0.002, "consistent"), (0.03, "suspect"), (0.05, "contradicted")])
def test_focus_that_says_more_than_size(by, word) -> None:
    """Each sweep knows the ratio to 1 %, and 0.5 % of it is the same in all."""
    found = Consistency("r1")
    for k in range(FEWEST_SWEEPS):
        assert told(found, k)[0] == "consistent"
        found.sweep(Ratio(math.log1p(by), 1e-4, 2.5e-5), False, k * S)
    got, cause = told(found, FEWEST_SWEEPS - 1.0)
    assert got == word
    assert word == "consistent" or f"focus says {100 * by:.1f} % more than size" in cause


def test_sweeps_that_are_refused_for_their_two_ranges_contradict_each_other() -> None:
    found = Consistency("r1")
    for k in range(10):
        found.sweep(Ratio(0.1, 1.0, 1.0), k % 5 != 0, k * S)
    assert told(found, 9.0)[0] == "contradicted"


@pytest.mark.parametrize(("nis", "word"), [(3.0, "consistent"), (6.0, "suspect"), (12.0, "contradicted")])
def test_samples_that_scatter_by_more_than_they_say(nis, word) -> None:
    found = Consistency("r1")
    for k in range(FEWEST):
        found.update(Explain(nis=nis), False, k * S)
    assert told(found, FEWEST - 1.0)[0] == word


def test_all_ranges_long_by_a_factor() -> None:
    found = Consistency("r1")
    found.update(Explain(stretch=(0.02, 0.004)), False, S)
    assert told(found, 1.0)[0] == "suspect"
    assert "all ranges are 2.0 % (+-0.4) long" in told(found, 1.0)[1]
