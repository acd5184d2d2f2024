"""The rate by itself: steps at given times, no clock."""

import math

import pytest

from agent.clock.keeper import LOWEST, STANDING_NS, WINDOW_NS, Rate

TICK_NS = 10_000_000


def run(rate: Rate, from_ns: tuple[int, int], seconds: float, wall_s_a_second: float, complete: bool = True):
    """Ticks of a machine that needs so much wall time for a second of run time; returns where it ends."""
    now_ns, wall_ns = from_ns
    expected = 0.0
    for _ in range(round(seconds * 1e9 / TICK_NS)):
        now_ns, wall_ns = now_ns + TICK_NS, wall_ns + round(TICK_NS * wall_s_a_second)
        expected = rate.step(now_ns, wall_ns, complete)
    return (now_ns, wall_ns), expected


def test_a_machine_that_keeps_up_gets_what_was_asked_for() -> None:
    _, expected = run(Rate(1.0, 0, 0), (0, 0), 3.0, 1.0)
    assert expected == 1.0


def test_it_gives_way_and_comes_back() -> None:
    rate = Rate(1.0, 0, 0)
    at, _ = run(rate, (0, 0), 2.0, 1.0)
    at, expected = run(rate, at, 2.0, 2.5)  # a machine that manages 0.4
    assert rate.achieved == pytest.approx(0.4, rel=0.05)
    assert 0.4 < expected <= 0.8  # with headroom: who sleeps too long holds up the others
    at, expected = run(rate, at, 2.0, 1.0)
    assert expected == 1.0
    assert min(rate.told) == pytest.approx(0.4, rel=0.1) and max(rate.told) == pytest.approx(1.0, rel=0.05)


def test_without_a_limit_it_grows_until_the_machine_is_the_limit() -> None:
    rate = Rate(math.inf, 0, 0)
    at, expected = run(rate, (0, 0), 1.0, 1.0)
    assert expected > 1.0
    for _ in range(20):
        at, expected = run(rate, at, 1.0, 1.0 / min(expected, 3.0))  # the machine manages 3
    assert rate.achieved == pytest.approx(3.0, rel=0.05) and 3.0 < expected < 7.0


def test_nobody_is_hurried_past_who_is_still_to_come() -> None:
    rate = Rate(math.inf, 0, 0)
    at, expected = run(rate, (0, 0), 2.0, 1.0, complete=False)
    assert expected == 1.0 and not rate.told
    _, expected = run(rate, at, 2.0, 0.5)
    assert expected > 1.0
    assert Rate(0.25, 0, 0).achieved == 0.25  # but slower, if slower was asked for


def test_a_twin_that_was_stopped_learns_nothing_from_it() -> None:
    rate = Rate(1.0, 0, 0)
    (now_ns, wall_ns), _ = run(rate, (0, 0), 2.0, 1.0)
    wall_s = rate.wall_s
    assert rate.step(now_ns + TICK_NS, wall_ns + 20 * STANDING_NS, True) == 1.0
    assert rate.wall_s == wall_s


def test_what_is_expected_has_a_floor() -> None:
    rate = Rate(1.0, 0, 0)
    now_ns = wall_ns = 0
    for _ in range(5):
        now_ns, wall_ns = now_ns + TICK_NS, wall_ns + WINDOW_NS
        expected = rate.step(now_ns, wall_ns, True)
    assert expected == LOWEST
