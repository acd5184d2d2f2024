"""Pointing and search as state machines: the gimbal's play is taken from one side, and the search sees both sides."""

from agent.core.control.pointing import HIGHEST_US, LOWEST_US, PLAY_US, Pointing, Search, reachable

S = 1_000_000_000


def test_final_approach_always_comes_from_below() -> None:
    pointing, now = Pointing(), 0
    for goal in ((1500, 1500), (1700, 1400), (1600, 1450)):
        pointing.aim(goal, now)
        assert pointing.servos_us(now) == (goal[0] - PLAY_US, goal[1] - PLAY_US)
        assert not pointing.steady(now)
        now += 3 * S
        assert pointing.servos_us(now) == goal
        assert pointing.steady(now)
    before = pointing.steady_from_ns
    pointing.aim((1600, 1450), now)
    assert pointing.steady_from_ns == before


def test_no_pulse_is_asked_for_that_a_board_refuses() -> None:
    for goal in ((480, 500), (500, 979), (2500, 1500), (2600, 2501)):
        pointing = Pointing()
        pointing.aim((1500, 1500), 0)
        pointing.aim(reachable(goal), 10**9)
        for t_ns in range(10**9, 4 * 10**9, 10**8):
            assert all(LOWEST_US <= pulse <= HIGHEST_US for pulse in pointing.servos_us(t_ns))
    assert reachable((1234, 1400)) == (1234, 1400)


def test_search_waits_for_the_gimbal_and_visits_both_sides() -> None:
    search, now, seen = Search(), 0, []
    assert search.offset_deg(steady=False, now_ns=100 * S) == (0.0, 0.0)
    for _ in range(40):
        seen.append(search.offset_deg(steady=True, now_ns=now))
        now += S
    assert min(p for p, _ in seen) < -30 < 30 < max(p for p, _ in seen)
    search.reset()
    assert search.offset_deg(steady=True, now_ns=now) == (0.0, 0.0)
