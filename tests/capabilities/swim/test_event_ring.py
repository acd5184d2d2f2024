"""Events in any order of arrival give the filter of somebody who heard all of them in time."""

import math
import random

import numpy as np
import pytest

from agent.capabilities.swim.event_ring import (
    KEEP_NS,
    RING_NS,
    EventRing,
    Seen,
    Smoother,
    asked,
    fix,
    flow,
    offset_m,
    rate,
)
from agent.capabilities.swim.pose_filter import Drift, Hull, add_sighting, begin, keep_key, target_of
from agent.core.linear_algebra import upper

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


# --- a sighting, once more with what came after it ---

AT = (0.8, 0.9, 0.4)
OWN = upper(np.array([[4e-4, 1e-4, 2e-4], [1e-4, 9e-4, -3e-4], [2e-4, -3e-4, 9e-4]]))
R_M2 = upper(np.array([[4e-6, 1e-6, 1e-6], [1e-6, 3e-6, 0.0], [1e-6, 0.0, 2e-6]]))
TARGET = (1.5, 1.0, 0.07)
J = np.array([[1.0, 0.0, -0.1], [0.0, 1.0, 0.7], [0.0, 0.0, 0.0]])  # of its place by the pose
SEEN = Seen("ball", S // 10, offset_m(AT, TARGET), R_M2, R_M2)


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.parametrize("gyro", [False, True])
@pytest.mark.parametrize("key", [False, True])
def test_a_sighting_puts_its_place_into_the_state_as_a_textbook_has_it(gyro, key) -> None:
    """J P J' + R, whether there is a gyro's bias, or a clone."""
    belief = begin(0, AT, OWN, gyro=gyro)
    seen = add_sighting(keep_key(belief) if key else belief, SEEN.offset_m, R_M2)
    place, spread_m2 = target_of(seen)
    np.testing.assert_allclose(place, TARGET, atol=1e-12)
    np.testing.assert_allclose(full(spread_m2), J @ full(OWN) @ J.T + full(R_M2), atol=1e-15)
    np.testing.assert_allclose(seen.P, np.transpose(seen.P), atol=1e-18)


def test_with_a_yaw_that_nobody_knows_a_sighting_says_nothing() -> None:
    turned = begin(0, AT, (*OWN[:5], math.radians(6.0) ** 2))
    assert Smoother(HULL).place(SEEN, turned) is None


def test_later_fixes_tell_where_it_was_at_a_sighting() -> None:
    rests = np.diag([4e-4, 4e-4, 4e-4, *[1e-8] * 3, *[1e-12] * 5])  # x, y and yaw stay what they are
    first = begin(0, AT, OWN)._replace(P=tuple(map(tuple, rests.tolist())))
    smoother = Smoother(HULL)
    before = EventRing(first, HULL, Drift()).at(SEEN.t_ns - 1)
    place, spread_m2 = smoother.place(SEEN, before)
    np.testing.assert_allclose(place, TARGET, atol=1e-9)
    np.testing.assert_allclose(full(spread_m2), full(R_M2) + 4e-4 * J @ J.T, rtol=1e-3, atol=1e-6)
    noise = np.diag([1e-6, 1e-6, 1e-6])
    for k in range(2, 5):
        smoother.add(fix(k * S // 10, (0.81, 0.9, 0.4), upper(noise), (0.0,) * 6))
    place, spread_m2 = smoother.place(SEEN, before)
    np.testing.assert_allclose(place, (1.51, 1.0, 0.07), atol=2e-4)  # it was there a centimetre farther ahead
    least = full(R_M2) + J @ (noise / 3.0) @ J.T  # three fixes of one pose; it may have moved a little since
    assert (np.linalg.eigvalsh(full(spread_m2) - least) > -1e-9).all()
    assert (np.linalg.eigvalsh(1.5 * least - full(spread_m2)) > 0.0).all()
    smoother.reset()
    assert smoother.place(SEEN, before)[0] == pytest.approx(TARGET)
