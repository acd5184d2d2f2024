"""Whose word counts: by signature in fleets with keys, by mouth in fleets without."""

import pytest

from agent.core.messages import Epoch, Proposal
from agent.core.trust import (
    ALARM_NS,
    BESIDE_NS,
    BURST,
    DIRECT_NS,
    DRIFT,
    HEARSAY,
    INSISTS,
    JUMP,
    LEAST_NS,
    OVERDRAWN,
    VERIFIED_HZ,
    Authority,
    EpochVote,
    OriginClocks,
    Transit,
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


def proposed(by: str, counter: int = 1, since_ns: int = 5) -> Proposal:
    return Proposal(by, since_ns, counter, counter % 2 == 1)


def vote(*heard: Proposal, now_ns: int = 0) -> EpochVote:
    """What r1 knows after it heard these."""
    found = EpochVote("r1")
    for proposal in heard:
        assert found.is_news(proposal, REST)
        found.hear(proposal, now_ns)
    return found


def test_one_of_three_that_see_moves_nobody_and_two_do() -> None:
    assert vote(proposed("r2")).next(REST, 3, 0) is None
    assert vote(proposed("r2"), proposed("r3")).next(REST, 3, 0) == Epoch(1, True)


def test_ones_own_alarm_is_a_witness_too() -> None:
    found = vote(proposed("r2"))
    found.propose(REST, 10)
    assert found.next(REST, 3, 10) == Epoch(1, True)


def test_where_two_see_one_is_enough_but_not_more_often_than_every_ten_seconds() -> None:
    found = vote(proposed("r2"))
    assert found.next(REST, 2, 0) == Epoch(1, True)
    found.begin(Epoch(1, True), 0)
    found.hear(proposed("r2", 2), 1)
    assert found.next(Epoch(1, True), 2, LEAST_NS - 1) is None
    assert found.next(Epoch(1, True), 2, LEAST_NS) == Epoch(2, False)
    found.hear(proposed("r2", 900_000_001), 2)
    assert found.next(Epoch(1, True), 2, LEAST_NS) is None, "and not so far ahead"


def test_two_neighbours_that_are_there_show_the_way() -> None:
    found = EpochVote("r1")
    found.neighbour("r2", epoch_of(7), 0)
    assert found.next(REST, 0, 0) is None
    found.neighbour("r3", epoch_of(7), 1)
    assert found.next(REST, 0, 1) == Epoch(7, True)


def test_who_has_just_started_joins_those_that_it_hears_within_reason() -> None:
    found = EpochVote("r1")
    found.neighbour("r2", epoch_of(6), 0)
    assert found.next(REST, 0, 0) is None, "the others may not have spoken yet"
    assert found.next(REST, 0, BESIDE_NS) == Epoch(6, False)
    found.neighbour("r2", epoch_of(JUMP + 1), BESIDE_NS)
    assert found.next(REST, 0, BESIDE_NS) is None


def test_one_of_two_that_it_hears_does_not_lead_away_who_has_just_started() -> None:
    found = vote(proposed("r2", 21))
    found.neighbour("r2", epoch_of(21), 0)
    found.neighbour("r3", epoch_of(1), 0)
    for seeing in (0, 1, 2, 3):
        assert found.next(REST, seeing, 0) == epoch_of(1), "where both have been"
    found.begin(epoch_of(1), BESIDE_NS)
    assert found.next(epoch_of(1), 2, BESIDE_NS + 1) is None


def test_who_met_others_where_it_started_has_not_just_started() -> None:
    found = EpochVote("r1")
    found.neighbour("r3", REST, 0)
    assert found.next(REST, 0, 0) is None
    late_ns = 10 * BESIDE_NS
    found.neighbour("r2", epoch_of(6), late_ns)
    assert found.next(REST, 0, late_ns) is None


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
    assert found.next(REST, 3, late_ns) is None


def test_who_joins_hears_the_witnesses_of_the_epoch_that_is() -> None:
    found = vote(proposed("r2"), proposed("r3"))
    found.begin(Epoch(1, True), 0)
    assert {p.proposer for p in found.shown(10 * ALARM_NS)} == {"r2", "r3"}


@pytest.mark.parametrize("proposal", [proposed("r2", 10**9), Proposal("r2", 5, 1, False), Proposal("r2", 5, 2, True)])
def test_what_no_epoch_can_be_is_no_news(proposal) -> None:
    assert not EpochVote("r1").is_news(proposal, REST)


# --- times ---
# When something was said and measured, by clocks that nobody set and mouths that may lie.

HOUR_NS = 3600 * SECOND_NS


def test_clocks_that_differ_cancel_and_a_queue_shows() -> None:
    transit = Transit()
    assert transit.late_ns(HOUR_NS + 5, SECOND_NS) == 0
    assert transit.late_ns(HOUR_NS + 5 + SECOND_NS // 2, 2 * SECOND_NS) == SECOND_NS // 2


def test_one_stamp_from_nowhere_makes_nothing_late() -> None:
    for wild_ns in (-(2**62), 2**62, -SECOND_NS):
        transit = Transit()
        transit.late_ns(1000, SECOND_NS)
        transit.late_ns(wild_ns, SECOND_NS + 1)
        assert transit.late_ns(1000, SECOND_NS + 2) == 0
    for wild_ns in (-(2**62), 2**62):
        first = Transit()
        first.late_ns(wild_ns, SECOND_NS)
        for k in range(INSISTS):
            late_ns = first.late_ns(1000, SECOND_NS + 1 + k)
        assert late_ns == 0, "as its first word it is forgotten by the third honest one"


def test_a_first_stamp_a_little_ahead_is_forgotten_when_all_others_agree() -> None:
    transit, tenth_ns = Transit(), SECOND_NS // 10
    transit.late_ns(-SECOND_NS, 0)
    late_ns = [transit.late_ns(k % 3 * 10**6, k * tenth_ns) for k in range(1, 60)]
    assert late_ns[0] == SECOND_NS + 10**6
    assert max(late_ns[32:]) < 3 * 10**6


def test_a_queue_that_drains_is_no_clock() -> None:
    transit, tenth_ns = Transit(), SECOND_NS // 10
    transit.late_ns(0, 0)
    for k in range(1, 60):
        queued_ns = 2 * SECOND_NS - k * tenth_ns // 4
        assert transit.late_ns(queued_ns, k * tenth_ns) == queued_ns


def test_a_clock_that_was_really_set_is_believed_the_third_time() -> None:
    transit = Transit()
    transit.late_ns(1000, SECOND_NS)
    for k in range(INSISTS):
        transit.late_ns(1000 - HOUR_NS, SECOND_NS + k)
    assert transit.late_ns(1000 - HOUR_NS + 7, 2 * SECOND_NS) == 7


def test_a_relay_that_lies_about_ages_moves_a_sample_by_no_more_than_clocks_drift() -> None:
    clocks = OriginClocks()
    assert clocks.offset_ns("r1", 500, direct=True, now_ns=0) == 500
    for k in range(1, 11):
        offset_ns = clocks.offset_ns("r1", 500 - 5 * SECOND_NS, direct=False, now_ns=k * SECOND_NS)
    assert offset_ns >= 500 - 10 * DRIFT * SECOND_NS
    assert clocks.offset_ns("r1", 500 + 5 * SECOND_NS, direct=False, now_ns=11 * SECOND_NS) < 500


def test_the_own_mouth_corrects_what_a_relay_said_first() -> None:
    clocks = OriginClocks()
    clocks.offset_ns("r1", -HOUR_NS, direct=False, now_ns=0)
    assert clocks.offset_ns("r1", 500, direct=True, now_ns=1) == 500
