"""When something was said and measured, by clocks that nobody set and mouths that may lie."""

import pytest

from agent.core.link_clocks import AGREE_NS, DRIFT, INSISTS, LinkClock, OriginClocks, Transit, Way

SECOND_NS = 10**9
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
    assert clocks.offset("r1", 500, 0, direct=True, now_ns=0).offset_ns == 500
    for k in range(1, 11):
        offset_ns = clocks.offset("r1", 500 - 5 * SECOND_NS, 0, direct=False, now_ns=k * SECOND_NS).offset_ns
    assert offset_ns >= 500 - 10 * DRIFT * SECOND_NS
    assert clocks.offset("r1", 500 + 5 * SECOND_NS, 0, direct=False, now_ns=11 * SECOND_NS).offset_ns < 500


@pytest.mark.parametrize("slewed_ns", [360 * 1_000_000, -360 * 1_000_000])
def test_an_origin_whose_clock_is_slewed_is_followed(slewed_ns) -> None:
    """Within 20 s, as services that set clocks do; each round trip leaves 5 ms unknown."""
    clocks, bound_ns = OriginClocks(), 5_000_000
    for k in range(300):  # ten messages a second
        true_ns = round(slewed_ns * min(k / 200, 1.0))
        told = clocks.offset("r1", true_ns, bound_ns, direct=True, now_ns=k * SECOND_NS // 10)
        assert abs(told.offset_ns - true_ns) < AGREE_NS + 20_000_000, k
    assert abs(told.offset_ns - slewed_ns) < AGREE_NS + 2 * bound_ns


def test_the_own_mouth_corrects_what_a_relay_said_first() -> None:
    clocks = OriginClocks()
    clocks.offset("r1", -HOUR_NS, 0, direct=False, now_ns=0)
    assert clocks.offset("r1", 500, 0, direct=True, now_ns=1).offset_ns == 500


# --- the clock of a neighbour, by stamps that it echoes ---

MS = 1_000_000


def talk(clock: LinkClock, there_ns: int, back_ns: int, ahead_ns: int, seconds: range) -> list[Way | None]:
    """A message of ours each second takes there_ns, an answer 10 ms later back_ns; the other clock is ahead."""
    ways = []
    for s in seconds:
        sent_ns = s * SECOND_NS
        answered_ns = sent_ns + there_ns + 10 * MS
        arrived_ns = answered_ns + back_ns
        transit_ns = arrived_ns - (answered_ns + ahead_ns)
        clock.hear((sent_ns, 10 * MS), transit_ns, arrived_ns)
        ways.append(clock.way(transit_ns))
    return ways


@pytest.mark.parametrize("ahead_ns", [0, HOUR_NS, -HOUR_NS])
def test_a_delay_that_is_the_same_from_the_first_message_on_is_known(ahead_ns) -> None:
    assert set(talk(LinkClock(), 300 * MS, 300 * MS, ahead_ns, range(5))) == {Way(300 * MS, 300 * MS)}


def test_what_is_late_on_one_way_alone_is_within_the_bound() -> None:
    for way in talk(LinkClock(), 0, 600 * MS, 0, range(5)):
        assert way.late_ns == 300 * MS and abs(way.late_ns - 600 * MS) <= way.bound_ns


def test_before_the_first_echo_nobody_knows() -> None:
    clock = LinkClock()
    clock.hear(None, 5 * MS, SECOND_NS)
    assert clock.way(5 * MS) is None
    clock.hear((2 * SECOND_NS, 0), 5 * MS, SECOND_NS)
    assert clock.way(5 * MS) is None, "an echo of what was not yet said"


def test_the_quickest_round_trip_of_a_minute_counts() -> None:
    clock = LinkClock()
    talk(clock, 2 * MS, 2 * MS, 0, range(1))
    slow = talk(clock, 500 * MS, 500 * MS, 0, range(1, 59))
    assert set(slow) == {Way(500 * MS, 2 * MS)}
    assert talk(clock, 500 * MS, 500 * MS, 0, range(62, 64))[-1] == Way(500 * MS, 500 * MS), "it is forgotten"


def test_a_clock_that_was_set_is_known_by_the_next_echo() -> None:
    clock = LinkClock()
    talk(clock, 20 * MS, 20 * MS, 0, range(3))
    assert talk(clock, 20 * MS, 20 * MS, HOUR_NS, range(3, 4)) == [Way(20 * MS, 20 * MS)]
