"""A new epoch: two robots want it, or are in it; one alone empties nobody's table."""

import pytest

from agent.core.messages import Epoch, Proposal
from agent.core.trust import ALARM_NS, BESIDE_NS, JUMP, LEAST_NS, EpochVote, epoch_of

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
