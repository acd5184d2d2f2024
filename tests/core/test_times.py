"""When something was said and measured, by clocks that nobody set and mouths that may lie."""

from agent.core.trust import DRIFT, INSISTS, OriginClocks, Transit

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
    assert clocks.offset_ns("r1", 500, direct=True, now_ns=0) == 500
    for k in range(1, 11):
        offset_ns = clocks.offset_ns("r1", 500 - 5 * SECOND_NS, direct=False, now_ns=k * SECOND_NS)
    assert offset_ns >= 500 - 10 * DRIFT * SECOND_NS
    assert clocks.offset_ns("r1", 500 + 5 * SECOND_NS, direct=False, now_ns=11 * SECOND_NS) < 500


def test_the_own_mouth_corrects_what_a_relay_said_first() -> None:
    clocks = OriginClocks()
    clocks.offset_ns("r1", -HOUR_NS, direct=False, now_ns=0)
    assert clocks.offset_ns("r1", 500, direct=True, now_ns=1) == 500
