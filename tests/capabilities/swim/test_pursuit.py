"""A target that swims and is followed: who gets bearings of it, where the gaze goes, and two robots in closed loop."""

import math

import msgspec
import numpy as np
import pytest

from agent.capabilities.swim.pursuit import carried_on
from agent.core.config import Estimation, Follow, Hold, Look, Pose
from agent.core.estimation.interface import NOTHING, Posterior
from agent.core.estimation.moving_target import unseen
from agent.core.estimation.protocols import PURSUIT_S, iteration_ns, pursued
from agent.core.estimation.track import ROLLING, swimming
from agent.experiments.following_dive import Wanderer
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import START_NS, PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers

S = 1_000_000_000
NAMES = ("r1", "r2")
FISH = msgspec.structs.replace(basin.BALL, speed_m_s=0.15, turn_s=basin.TURN_S)


FOLLOWS = Follow(target="ball", standoff_m=0.7)
FROM_M = ((0.6, 0.6), (2.4, 0.6))


def fleet(ball=FISH, what=FOLLOWS, towards_m=(1.5, 1.0), **more):
    """Two robots, turned towards that place."""
    robots = {
        name: basin.robot(
            name,
            Pose(x_m=x, y_m=y, yaw_deg=math.degrees(math.atan2(towards_m[1] - y, towards_m[0] - x))),
            what,
            Look(tilt_deg=-5.0),
            tuple(other for other in NAMES if other != name),
        )
        for name, (x, y) in zip(NAMES, FROM_M, strict=True)
    }
    return msgspec.structs.replace(basin.fleet(robots, 3, ball), **more)


def test_only_what_swims_and_is_followed_is_pursued_and_only_with_evidence() -> None:
    assert pursued(fleet()) == ("ball",) and iteration_ns(fleet(), "ball") == round(PURSUIT_S * S)
    others = fleet(basin.BALL), fleet(what=Hold()), fleet(estimation=Estimation(protocol="paper"))
    for other in others:
        assert pursued(other) == () and iteration_ns(other, "ball") == S


def test_a_belief_is_carried_on_as_what_swims_forgets_its_course() -> None:
    believed = Posterior((1.0, 2.0, 0.3), NOTHING, (0.2, -0.1, 0.0), 10 * S)
    for seconds in (0.0, 0.11, 3.0):
        reach = 2.0 * (1.0 - math.exp(-seconds / 2.0))  # T (1 - e^(-t/T))
        found = carried_on(believed, swimming(0.15, 2.0), 10 * S + round(seconds * S))
        assert found == pytest.approx((1.0 + 0.2 * reach, 2.0 - 0.1 * reach, 0.3))
    assert carried_on(believed, swimming(0.15, 1e9), 9 * S) == pytest.approx((0.8, 2.1, 0.3))
    assert carried_on(believed._replace(t_ns=0), ROLLING, 10 * S) == believed.x_m


def test_what_nobody_sees_any_more_may_be_farther_and_farther_away() -> None:
    """To v_rms T in the end, and as sqrt(t) from then on; what rolls may go any way."""
    believed = Posterior((1.0, 2.0, 0.3), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), (0.2, 0.0, 0.0), 10 * S)
    moves = swimming(0.15, 2.0)
    basin_m = (1e3, 1e3, 1e3)  # so large that it says nothing
    sigmas = [math.sqrt(unseen(believed, moves, basin_m, (10 + t) * S).cov_m2[0]) for t in (0, 1, 4, 16)]
    assert sigmas[0] == pytest.approx(0.01)
    assert sigmas[1] == pytest.approx(math.hypot(0.01, 0.15 / math.sqrt(2)), rel=0.3)
    assert sigmas[3] == pytest.approx(2.0 * sigmas[2], rel=0.3)
    rolls = unseen(believed, ROLLING, basin_m, 20 * S)
    assert math.sqrt(rolls.cov_m2[0]) == pytest.approx(10.0 * ROLLING.first_speed_m_s, rel=0.01)
    assert rolls.x_m == pytest.approx(believed.x_m, abs=0.01), "it may have been rolled any way"


def test_a_target_that_is_not_seen_is_in_the_tank_at_least() -> None:
    believed, tank_m = Posterior((0.2, 2.0, 0.3), (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), t_ns=10 * S), (3.0, 2.4, 0.6)
    late = unseen(believed, swimming(0.15, 2.0), tank_m, 3600 * S)
    assert late.x_m == pytest.approx((1.5, 1.2, 0.3), abs=0.05)
    assert math.sqrt(late.cov_m2[0]) == pytest.approx(3.0 / math.sqrt(12.0), rel=0.05)


def test_two_robots_find_a_target_by_their_frames_and_go_with_it() -> None:
    """Planar bodies, tags and ball drawn; no sweep is ever begun."""
    fish = Wanderer(np.random.default_rng(6), 0.15, 20.0)
    of = fleet(towards_m=fish.at(START_NS)[:2])
    bodies = PlanarBodies(of)
    swimmers = Swimmers(of, bodies, fish.at)
    found, errors, off_deg, swept = [], [], [], 0
    for step in range(12 * 20):
        swimmers.step()
        swept += sum(outputs.sweep is not None for outputs in swimmers.outputs.values())
        if step < 9 * 20:
            continue
        at_m = np.array(fish.at(bodies.now_ns))
        for name, agent in swimmers.agents.items():
            found += [sighting.found for sighting in swimmers.inputs[name].sightings]
            believed = agent.measuring.current.estimator.posterior
            errors.append(np.array(believed.x_m) - fish.at(believed.t_ns))
            x, y, yaw = swimmers.place(name)
            x, y = x + 0.1 * math.cos(yaw), y + 0.1 * math.sin(yaw)  # of the gimbal
            pan = math.degrees(math.atan2(at_m[1] - y, at_m[0] - x) - yaw) - bodies.pose(name).pan_deg
            off_deg.append((pan + 180.0) % 360.0 - 180.0)
    assert swept == 0
    assert np.mean(found) > 0.9
    assert np.sqrt(np.mean(np.square(errors)[:, :2].sum(axis=1))) < 0.03
    assert np.sqrt(np.mean(np.square(off_deg))) < 3.0
