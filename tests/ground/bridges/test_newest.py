"""What is passed on as what is so now, and what is too old for that."""

from agent.ground.bridges.outward import Newest
from tests.ground.bridges.states import START_NS, S, state

AHEAD_NS = 3600 * S  # the robot's clock, of ours


def told(newest: Newest, sent_ns: int, arrived_ns: int, wall_ns: int | None = None, **about: int) -> None:
    newest.take(state(sent_ns=sent_ns, **about), arrived_ns, arrived_ns if wall_ns is None else wall_ns)


def test_one_that_was_never_heard_says_nothing() -> None:
    assert Newest().fresh("r1", START_NS, START_NS) is None


def test_it_is_fresh_for_three_seconds_whatever_its_clock_says() -> None:
    newest = Newest()
    told(newest, START_NS + AHEAD_NS, START_NS)
    assert newest.fresh("r1", START_NS + 3 * S, START_NS + 3 * S) is not None
    assert newest.fresh("r1", START_NS + 3 * S + 1, START_NS) is None
    assert newest.fresh("r1", START_NS, START_NS + 3 * S + 1) is None  # the fleet's clock stands


def test_a_burst_after_an_outage_is_old_when_it_comes() -> None:
    newest = Newest()
    told(newest, START_NS + AHEAD_NS, START_NS)
    late_ns = START_NS + 10 * S
    told(newest, START_NS + AHEAD_NS + 5 * S, late_ns)
    assert newest.fresh("r1", late_ns, late_ns) is None
    told(newest, START_NS + AHEAD_NS + 10 * S, late_ns)
    assert newest.fresh("r1", late_ns, late_ns) is not None


def test_clocks_that_go_apart_make_nobody_old() -> None:
    """20 hours of a clock that is 50 millionths slow: 3.6 s."""
    newest = Newest()
    for second in range(0, 20 * 3600, 10):
        arrived_ns = START_NS + second * S
        told(newest, START_NS + round(second * S * (1 - 50e-6)), arrived_ns)
        assert newest.fresh("r1", arrived_ns, arrived_ns) is not None


def test_a_new_start_has_a_clock_of_its_own() -> None:
    newest = Newest()
    told(newest, START_NS + AHEAD_NS, START_NS)
    told(newest, START_NS, START_NS + S, incarnation=START_NS)
    assert newest.fresh("r1", START_NS + S, START_NS + S) is not None
