"""The aided pose: against textbook conditioning, honest over many draws, and never said."""

import itertools
import math

import numpy as np
import pytest

from agent.capabilities.swim import pose_filter
from agent.capabilities.swim.aided_pose import Aid, Seen, aided, offset_m
from agent.capabilities.swim.event_ring import EventRing, asked, fix, flow, rate
from agent.capabilities.swim.pose_filter import Drift, Hull, add_sighting, begin, keep_key
from agent.capabilities.swim.swim import swimmer_of
from agent.core.codec import encode
from agent.core.config import Pose
from agent.core.estimation.interface import Posterior
from agent.core.linear_algebra import upper
from agent.core.step_io import SeenTags
from agent.experiments.navigation import basin
from agent.experiments.navigation.around_ball import BALL_LOOK, BALL_M
from agent.experiments.navigation.basin import START_NS, PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers
from agent.robot.step import Agent
from tests.capabilities.swim.drifting import S, drifted

OWN = upper(np.array([[4e-4, 1e-4, 2e-4], [1e-4, 9e-4, -3e-4], [2e-4, -3e-4, 9e-4]]))
STAYS = upper(np.diag([4e-6, 1e-6, 2e-6]))
R = upper(np.array([[4e-6, 1e-6, 1e-6], [1e-6, 3e-6, 0.0], [1e-6, 0.0, 2e-6]]))
D = upper(np.diag([9e-6, 4e-6, 2e-6]))
AT = (0.8, 0.9, 0.4)
OTHERS = Posterior((1.505, 0.99, 0.072), upper(np.array([[6e-6, 2e-6, 0.0], [2e-6, 5e-6, 0.0], [0.0, 0.0, 4e-6]])))


def full(a):
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


# --- the algebra ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("gyro", [False, True])
@pytest.mark.parametrize("key", [False, True])
def test_one_sighting_as_a_textbook_has_it(gyro, key) -> None:
    """x + K (z - h), P - K S K' with S = J P J' + R + D + C + J B J'; whether there is a gyro's bias, or a clone."""
    before = begin(0, AT, OWN, STAYS, gyro)
    P = np.array(before.P)
    seen = add_sighting(keep_key(before) if key else before, offset_m(AT, (1.5, 1.0, 0.07)), R)
    found = aided(seen, OTHERS, D)
    J = np.array([[1.0, 0.0, -0.1], [0.0, 1.0, 0.7], [0.0, 0.0, 0.0]])
    H = np.hstack([J, np.zeros((3, len(P) - 3))])
    S_ = H @ P @ H.T + full(R) + full(D) + full(OTHERS.cov_m2) + J @ full(STAYS) @ J.T
    K = np.linalg.solve(S_, H @ P).T
    np.testing.assert_allclose(found.x, before.x + K @ (np.array(OTHERS.x_m) - (1.5, 1.0, 0.07)), atol=1e-12)
    np.testing.assert_allclose(found.P, P - K @ S_ @ K.T, atol=1e-14)
    assert (np.array(found.P) == np.array(found.P).T).all()
    assert found.stays == STAYS and found.key_ns is None and not found.has_target


def test_the_others_error_counts_once_however_often_the_target_is_seen() -> None:
    belief = begin(0, AT, OWN)
    for _ in range(200):
        belief = add_sighting(belief, offset_m(AT, (1.5, 1.0, 0.07)), R)
    J = np.array([[1.0, 0.0, -0.1], [0.0, 1.0, 0.7], [0.0, 0.0, 0.0]])
    P = full(OWN)
    S_ = J @ P @ J.T + full(R) / 200.0 + full(D) + full(OTHERS.cov_m2)
    expected = P - P @ J.T @ np.linalg.solve(S_, J @ P)
    found = np.array(aided(belief, Posterior((1.5, 1.0, 0.07), OTHERS.cov_m2), D).P)[:3, :3]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    place = J @ found @ J.T
    assert np.linalg.eigvalsh(place - full(OTHERS.cov_m2) * [1, 1, 0])[:2].max() > 0.0
    assert place[0, 0] > 0.9 * OTHERS.cov_m2[0] and place[1, 1] > 0.9 * OTHERS.cov_m2[3]


def test_words_that_cannot_be_and_a_yaw_that_nobody_knows_are_of_no_use() -> None:
    seen = add_sighting(begin(0, AT, OWN), offset_m(AT, (1.5, 1.0, 0.07)), R)
    assert aided(seen, Posterior((1.9, 1.0, 0.07), OTHERS.cov_m2), D) is None
    assert aided(seen, Posterior((1.5, 1.0, 0.12), OTHERS.cov_m2), D) is None, "its height is wrong"
    turned = begin(0, AT, (*OWN[:5], math.radians(6.0) ** 2))
    assert add_sighting(turned, offset_m(AT, (1.5, 1.0, 0.07)), R) is turned
    assert aided(turned, OTHERS, D) is None


# --- beside the own filter --------------------------------------------------------------------------------------


def arrivals():
    """A second and a half of events: (time, what)."""
    found = [fix(k * S // 5, (0.8, 0.9 + 0.001 * k, 0.4), OWN, STAYS) for k in range(1, 8)]
    found += [asked(k * S // 4 + 7, (0.2 * k, 0.1, 0.01)) for k in range(1, 6)]
    found += [rate(k * S // 3 + 3, 0.01) for k in range(1, 5)]
    return [*found, flow(14 * S // 10, 9 * S // 10, (0.01, 0.0, 0.002), OWN)]


def told(order, late):
    """The aided pose after 1.5 s; late: how many of the events come only after the sighting of 1.0 s."""
    ring, aid = EventRing(begin(0, AT, OWN, STAYS, gyro=True), Hull(), Drift()), Aid(Hull())
    seen = Seen("ball", S, offset_m(AT, (1.5, 1.0, 0.07)), R, D)
    for k, event in enumerate((*order, None)):
        if k == len(order) - late:
            aid.see(seen)
            aid.begin(ring.at(S // 2))
        if event is not None and ring.add(event):
            aid.add(event)
    return aid.at(ring.at(3 * S // 2), OTHERS)


def test_the_same_bytes_in_any_order_of_arrival() -> None:
    first, *after = sorted(arrivals(), key=lambda e: e.t_ns > S // 2)  # those that are settled at the sighting first
    settled = [e for e in (first, *after) if e.t_ns <= S // 2]
    late = [e for e in after if e.t_ns > S // 2]
    expected = told([*settled, *late], 0)
    assert expected is not None
    for k, order in enumerate(itertools.islice(itertools.permutations(late), 0, 40320, 8009)):
        assert told([*settled, *order], 2 * k % len(late)) == expected


def test_it_starts_when_others_know_better_and_ends_when_they_do_not() -> None:
    aid, unsure, sure = Aid(Hull()), begin(0, AT, OWN), begin(0, AT, upper(np.diag([1e-6, 1e-6, 1e-6])))
    seen = Seen("ball", 1, offset_m(AT, (1.5, 1.0, 0.07)), R, D)
    assert not aid.needed(unsure, OTHERS), "nothing was seen"
    aid.see(seen)
    assert not aid.needed(sure, OTHERS) and not aid.needed(unsure, None) and aid.needed(unsure, OTHERS)
    assert not aid.needed(unsure._replace(t_ns=5 * S), OTHERS), "too long ago"
    assert aid.at(unsure, OTHERS) is None
    aid.begin(unsure)
    assert not aid.needed(unsure, OTHERS) and aid.at(unsure._replace(t_ns=2), OTHERS) is not None
    assert aid.at(sure._replace(t_ns=3), OTHERS) is None and aid.needed(unsure, OTHERS)
    aid.begin(unsure)
    assert aid.at(unsure._replace(t_ns=3), None) is None and aid.target is None, "the target has moved, say"


def test_it_is_as_good_as_it_says_and_better_than_nothing() -> None:
    rows = [row for seed in range(6) for row in drifted(seed, 12.0, 6.0)]
    aided_ones = [row for row in rows if row[2] is not None]
    own_m, aided_m = (math.sqrt(np.mean([row[k] ** 2 for row in aided_ones])) for k in (0, 1))
    assert len(aided_ones) > 0.4 * len(rows) and aided_m < 0.6 * own_m
    # Of chi-square by its three degrees the median is 0.79. The mean of six drifts is mostly that of the wildest one.
    assert 0.5 < np.median([row[2] for row in aided_ones]) < 1.2


def test_without_the_gate_of_yaw_it_boasts(monkeypatch) -> None:
    monkeypatch.setattr(pose_filter, "YAW_KNOWN_RAD", math.pi)
    rows = [row for seed in range(5) for row in drifted(seed, 6.0, 60.0, yaw_sigma=math.radians(20.0))]
    assert np.mean([row[2] for row in rows if row[2] is not None]) > 4.0
    monkeypatch.undo()
    rows = [row for seed in range(1) for row in drifted(seed, 6.0, 60.0, yaw_sigma=math.radians(20.0))]
    assert all(row[2] is None for row in rows)


# --- no echo ----------------------------------------------------------------------------------------------------


def test_nothing_that_is_said_has_anything_of_it() -> None:
    """r1 sees no more tags and is aided by the ball; once more with the same inputs, forces and ways to look, but the
    own pose in all that it decides: the same bytes to everybody."""
    names = ("r1", "r2")
    poses = (
        Pose(x_m=BALL_M[0] - 0.7, y_m=BALL_M[1], yaw_deg=0.0),
        Pose(x_m=BALL_M[0] + 0.7, y_m=BALL_M[1], yaw_deg=180.0),
    )
    fleet = basin.fleet(
        {
            name: basin.robot(name, pose, None, BALL_LOOK, tuple(other for other in names if other != name))
            for name, pose in zip(names, poses, strict=True)
        },
        3,
    )
    swimmers = Swimmers(fleet, PlanarBodies(fleet), BALL_M)
    one, tank = swimmers.agents["r1"], swimmers.eyes["r1"].tank
    expose = tank.expose
    tank.expose = lambda pose, t_ns: (
        expose(pose, t_ns) if t_ns < START_NS + 11 * S else (SeenTags(t_ns=t_ns, frame=0, tags=()), None)
    )
    did, apart = [], []
    for _ in range(14 * 20):
        swimmers.step()
        swimmer = swimmer_of(one.capabilities)
        own = swimmer.localizer.at(swimmers.now_ns)
        did.append((swimmers.now_ns, swimmers.inputs["r1"], swimmers.outputs["r1"], one._situation.pose))
        apart.append(0.0 if own is None else math.dist(own.pose[:2], swimmer.here.pose[:2]))
    assert sum(off > 0.003 for off in apart) > 20
    again = Agent(fleet, "r1", swimmers.calibrations["r1"], START_NS)
    decided = {now_ns: (outputs.set_point, pose) for now_ns, _, outputs, pose in did}
    swimmer = swimmer_of(again.capabilities)
    sent = swimmer.localizer.sent

    def steer(others, now_ns):
        return decided[now_ns][1]

    def send(wrench, now_ns):
        to = decided[now_ns][0]
        sent((*to.force_n, to.yaw_moment_nm), now_ns)

    swimmer.steer, swimmer.localizer.sent = steer, send
    differed = 0
    for now_ns, inputs, outputs, _ in did:
        told = again.step(inputs, now_ns)
        assert [encode(each) for each in told.says] == [encode(each) for each in outputs.says]
        assert told.outgoing == outputs.outgoing
        differed += told.set_point.force_n != outputs.set_point.force_n
    assert differed > 20  # where it is decides where it swims


def test_later_fixes_tell_where_it_was_at_a_sighting() -> None:
    rests = np.diag([4e-4, 4e-4, 4e-4, *[1e-8] * 3, *[1e-12] * 5])  # x, y and yaw stay what they are
    first = begin(0, AT, OWN)._replace(P=tuple(map(tuple, rests.tolist())))
    ring, aid = EventRing(first, Hull(), Drift(*[0.0] * 6)), Aid(Hull())
    seen, before = Seen("ball", S // 10, offset_m(AT, (1.5, 1.0, 0.07)), R, D), ring.at(S // 10 - 1)
    J = np.array([[1.0, 0.0, -0.1], [0.0, 1.0, 0.7], [0.0, 0.0, 0.0]])
    place, spread_m2 = aid.smoothed(seen, before)
    np.testing.assert_allclose(place, (1.5, 1.0, 0.07), atol=1e-9)
    np.testing.assert_allclose(full(spread_m2), full(R) + 4e-4 * J @ J.T, rtol=1e-3, atol=1e-8)
    noise = np.diag([1e-6, 1e-6, 1e-6])
    for k in range(2, 5):
        event = fix(k * S // 10, (0.81, 0.9, 0.4), upper(noise), STAYS)
        assert ring.add(event)
        aid.add(event)
    place, spread_m2 = aid.smoothed(seen, before)
    np.testing.assert_allclose(place, (1.51, 1.0, 0.07), atol=2e-4)  # it was there a centimetre farther ahead
    least = full(R) + J @ (noise / 3.0) @ J.T  # three fixes of one pose; it may have moved a little since
    assert (np.linalg.eigvalsh(full(spread_m2) - least) > -1e-9).all()
    assert (np.linalg.eigvalsh(1.5 * least - full(spread_m2)) > 0.0).all()
