"""Whose word counts: by signature in fleets with keys, by mouth in fleets without."""

import pytest

from agent.core.messages import Epoch, Proposal
from agent.core.trust import (
    ALARM_NS,
    ALONE_NS,
    BESIDE_NS,
    BURST,
    DIRECT_NS,
    HEARSAY,
    JUMP,
    LEAST_NS,
    OVERDRAWN,
    QUIET_NS,
    VERIFIED_HZ,
    Authority,
    EpochVote,
    epoch_of,
)

SECOND_NS = 10**9
SAYS = b"what was said"


def genuine(public: bytes, signature: bytes, said: bytes) -> bool:
    return signature == public + said


def fault(authority: Authority, src: str, origin: str, signature: bytes = b"", now_ns: int = 0) -> str | None:
    return authority.fault(src, origin, signature, lambda: SAYS, now_ns)


@pytest.fixture
def signed() -> Authority:
    authority = Authority(("r2", "r3"), genuine)
    authority.keys = {"r2": b"two", "r3": b"three"}
    return authority


def test_a_signature_counts_from_any_mouth_and_nothing_else_does(signed) -> None:
    assert fault(signed, "r2", "r3", b"three" + SAYS) is None
    assert fault(signed, "r3", "r3") == "unsigned"
    assert fault(signed, "r3", "r4", b"four" + SAYS) == "no key"
    assert fault(signed, "r3", "r2", b"three" + SAYS) == "bad signature"


def test_a_wrong_signature_empties_the_budget_of_who_passed_it_on_and_of_nobody_else(signed) -> None:
    assert fault(signed, "r2", "r3", b"wrong") == "bad signature"
    assert fault(signed, "r2", "r3", b"three" + SAYS) == OVERDRAWN
    assert fault(signed, "r3", "r3", b"three" + SAYS) is None
    signed.heard("r2", round(1.01 / VERIFIED_HZ * SECOND_NS))
    assert fault(signed, "r2", "r3", b"three" + SAYS) is None, "and it fills again"


def test_a_flood_of_genuine_signatures_is_verified_at_the_rate_that_is_bearable(signed) -> None:
    verified = 0
    for k in range(10_000):  # in one second
        signed.heard("r2", k * SECOND_NS // 10_000)
        verified += fault(signed, "r2", "r3", b"three" + SAYS) is None
    assert verified <= BURST + VERIFIED_HZ


def test_without_keys_who_is_heard_speaks_for_itself() -> None:
    authority = Authority(("r2", "r3"))
    assert fault(authority, "r3", "r2", now_ns=SECOND_NS) is None, "r2 was never heard: r3 may speak for it"
    authority.heard("r2", SECOND_NS)
    assert fault(authority, "r3", "r2", now_ns=SECOND_NS) == HEARSAY
    assert fault(authority, "r2", "r2", now_ns=SECOND_NS) is None
    assert fault(authority, "r3", "r2", now_ns=SECOND_NS + DIRECT_NS + 1) is None, "silent for long"


# --- epoch vote ---
# A new epoch: two robots want it, or are in it; one alone empties nobody's table.

REST = Epoch()


def proposed(by: str, counter: int = 1, since_ns: int = 5, **about) -> Proposal:
    return Proposal(by, since_ns, counter, counter % 2 == 1, **about)


def vote(*heard: Proposal, now_ns: int = 0) -> EpochVote:
    """What r1 knows after it heard these."""
    found = EpochVote("r1")
    for proposal in heard:
        assert found.is_news(proposal, REST)
        found.hear(proposal, now_ns)
    return found


def seen(robots: int) -> dict[str, int]:
    """When each of so many robots measured the target last."""
    return {f"r{k}": 10**15 for k in range(1, robots + 1)}


def test_one_of_three_that_see_moves_nobody_and_two_do() -> None:
    assert vote(proposed("r2")).next(REST, seen(3), 0) is None
    assert vote(proposed("r2"), proposed("r3")).next(REST, seen(3), 0) == Epoch(1, True)


def test_ones_own_alarm_is_a_witness_too() -> None:
    found = vote(proposed("r2"))
    found.propose(REST, 10)
    assert found.next(REST, seen(3), 10) == Epoch(1, True)


def test_where_two_see_one_is_enough_but_not_more_often_than_every_ten_seconds() -> None:
    found = vote(proposed("r2"))
    assert found.next(REST, seen(2), 0) == Epoch(1, True)
    found.begin(Epoch(1, True), 0)
    found.hear(proposed("r2", 2), 1)
    assert found.next(Epoch(1, True), seen(2), LEAST_NS - 1) is None
    assert found.next(Epoch(1, True), seen(2), LEAST_NS) == Epoch(2, False)
    found.hear(proposed("r2", 900_000_001), 2)
    assert found.next(Epoch(1, True), seen(2), LEAST_NS) is None, "and not so far ahead"


def test_two_neighbours_that_are_there_show_the_way() -> None:
    found = EpochVote("r1")
    found.neighbour("r2", epoch_of(7), 0)
    assert found.next(REST, seen(0), 0) is None
    found.neighbour("r3", epoch_of(7), 1)
    assert found.next(REST, seen(0), 1) == Epoch(7, True)


def test_who_has_just_started_joins_those_that_it_hears_within_reason() -> None:
    found = EpochVote("r1")
    found.neighbour("r2", epoch_of(6), 0)
    assert found.next(REST, seen(0), 0) is None, "the others may not have spoken yet"
    assert found.next(REST, seen(0), BESIDE_NS) == Epoch(6, False)
    found.neighbour("r2", epoch_of(JUMP + 1), BESIDE_NS)
    assert found.next(REST, seen(0), BESIDE_NS) is None


def test_one_of_two_that_it_hears_does_not_lead_away_who_has_just_started() -> None:
    found = vote(proposed("r2", 21))
    found.neighbour("r2", epoch_of(21), 0)
    found.neighbour("r3", epoch_of(1), 0)
    for seeing in (0, 1, 2, 3):
        assert found.next(REST, seen(seeing), 0) == epoch_of(1), "where both have been"
    found.begin(epoch_of(1), BESIDE_NS)
    assert found.next(epoch_of(1), seen(2), BESIDE_NS + 1) is None


def test_who_met_others_where_it_started_has_not_just_started() -> None:
    found = EpochVote("r1")
    found.neighbour("r3", REST, 0)
    assert found.next(REST, seen(0), 0) is None
    late_ns = 10 * BESIDE_NS
    found.neighbour("r2", epoch_of(6), late_ns)
    assert found.next(REST, seen(0), late_ns) is None


def test_a_proposal_that_nobody_seconds_was_a_knock() -> None:
    found = EpochVote("r1")
    found.propose(REST, 0)
    assert not found.unseconded(REST, ALARM_NS)
    assert found.unseconded(REST, ALARM_NS + 1)
    assert found.shown(ALARM_NS + 1) == ()


def test_an_old_knock_does_not_second_a_later_one() -> None:
    found = vote(proposed("r2"))
    late_ns = ALARM_NS + 1
    assert not found.is_news(proposed("r2"), REST), "relays tell it for ever"
    found.hear(proposed("r3"), late_ns)
    assert found.next(REST, seen(3), late_ns) is None


def test_who_joins_hears_the_witnesses_of_the_epoch_that_is() -> None:
    found = vote(proposed("r2"), proposed("r3"))
    found.begin(Epoch(1, True), 0)
    assert {p.proposer for p in found.shown(10 * ALARM_NS)} == {"r2", "r3"}


@pytest.mark.parametrize("proposal", [proposed("r2", 10**9), Proposal("r2", 5, 1, False), Proposal("r2", 5, 2, True)])
def test_what_no_epoch_can_be_is_no_news(proposal) -> None:
    assert not EpochVote("r1").is_news(proposal, REST)


STEP_M = (0.06, 0.0, 0.0)


def test_two_that_looked_again_refute_a_step_and_who_told_of_it_waits() -> None:
    found = EpochVote("r1")
    found.propose(REST, 0, STEP_M)
    assert found.pending(REST, 1).proposal.step_m == STEP_M
    for name in ("r2", "r3"):
        found.hear(proposed(name, step_m=STEP_M, against=True), 1)
    assert found.pending(REST, 1) is None
    assert found.next(REST, seen(3), 1) is None
    assert found.unseconded(REST, 1)
    found.propose(REST, 2, STEP_M)
    assert found.pending(REST, 2) is None, "it was refuted a moment ago"
    later_ns = QUIET_NS + ALARM_NS
    found.propose(REST, later_ns, STEP_M)
    assert found.pending(REST, later_ns) is not None


def test_of_one_eyewitness_nobody_else_measured_since_is_enough_after_three_seconds() -> None:
    found = vote(proposed("r2", step_m=STEP_M))
    since = {"r2": ALONE_NS, "r3": 0}
    assert found.next(REST, since, ALONE_NS - 1) is None
    assert found.next(REST, {**since, "r3": 1}, ALONE_NS) is None, "r3 has looked again, and speaks for itself"
    assert found.next(REST, since, ALONE_NS) == Epoch(1, True)
