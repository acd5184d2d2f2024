"""Events in any order of arrival give the filter of somebody who heard all of them in time."""

import random

import numpy as np

from agent.capabilities.swim.event_ring import KEEP_NS, RING_NS, EventRing, asked, fix, flow, rate
from agent.capabilities.swim.pose_filter import Drift, Hull, begin

HULL, DRIFT = Hull(), Drift(doubt_s=0.0)
R = (1e-5, 1e-6, 2e-7, 2e-5, -1e-6, 4e-6)
FLOW = (9e-6, 0.0, 0.0, 9e-6, 0.0, 4e-6)  # of odometry
START = (1.0, 0.8, 0.5)
S = 1_000_000_000


def story(rng):
    """0.75 s of events of all kinds."""
    events, first_ns = [], 10 * S
    for k in range(15):
        events.append(asked(first_ns + 50_000_000 * k, tuple(rng.uniform(-1, 1, 3) * [3.0, 3.0, 0.4])))
    for k in range(7):
        events.append(fix(first_ns + 7_000_000 + 100_000_000 * k, tuple(START + rng.normal(0, 0.003, 3)), R, R))
    for k in range(14):
        events.append(rate(first_ns + 3_000_000 + 50_000_000 * k, float(rng.normal(0, 0.01))))
    for key, nows in ((107, (207, 307, 407)), (407, (507, 607))):
        for now in nows:
            moved = tuple(rng.normal(0, 0.003, 3))
            events.append(flow(first_ns + now * 1_000_000, first_ns + key * 1_000_000, moved, FLOW))
    return events


def ring():
    return EventRing(begin(10 * S - 100_000_000, START, R, gyro=True), HULL, DRIFT)


def test_any_order_of_arrival_gives_the_same_bytes() -> None:
    events = story(np.random.default_rng(8))
    ends = set()
    for seed in range(3):
        here = ring()
        for event in sorted(events) if seed == 0 else random.Random(seed).sample(events, len(events)):
            here.add(event)
        assert here.dropped == 0 and here.newest.restarts == 0 and here.newest.key_ns == 10 * S + 407_000_000
        ends.add(repr([here.newest, here.at(10 * S + 350_000_000), here.at(11 * S)]))
    assert len(ends) == 1
    in_step = ring()
    for event in sorted(events):  # as they would come in time, with the ring moving on
        in_step.advance(event.t_ns)
        in_step.add(event)
    assert repr([in_step.newest, in_step.at(10 * S + 350_000_000), in_step.at(11 * S)]) in ends


def test_what_comes_too_late_is_counted_and_changes_nothing() -> None:
    here, late = ring(), story(np.random.default_rng(8))[17]
    for k in range(100):
        now_ns = 10 * S + k * 50_000_000
        here.add(asked(now_ns, (1.0, 0.0, 0.0)))
        here.advance(now_ns)
    before = here.newest
    here.add(late)
    assert here.dropped == 1 and here.newest == before
    here.add(fix(now_ns - RING_NS + 60_000_000, before.pose, R, R))
    assert here.dropped == 1 and here.newest != before


def test_beliefs_are_kept_for_a_sweep() -> None:
    here, beliefs = ring(), {}
    for k in range(200):
        now_ns = 10 * S + k * 50_000_000
        here.add(asked(now_ns, (1.0, 0.5, 0.1)))
        here.advance(now_ns)
        beliefs[now_ns] = here.newest
    assert here.at(now_ns - KEEP_NS) == beliefs[now_ns - KEEP_NS]
    between = here.at(now_ns - KEEP_NS + 20_000_000)
    assert between.t_ns == now_ns - KEEP_NS + 20_000_000 and between.x[0] != beliefs[now_ns - KEEP_NS].x[0]
    assert here.at(now_ns - KEEP_NS - 60_000_000) is None
