"""Keep a distance from a target that may move: which place around it, how fast there, and which way to face.

Each robot decides for itself. With th the bearing from the target to the robot, th_j that to another of the n that
follow it, and g = wrap(th - th_j):

    push = sum_j sgn(g) max(0, 0.9 * 2 pi / max(n, 3) - |g|)
    goal = target + standoff (cos, sin)(th + push / 2 + d)
    d of DETOURS with the least  |d| + 2 hidden + 5 reach / m + far / m

drawn inside the walls; reach is what the wall takes from the distance, hidden whether another robot, or what hid the
target lately, is in between, far by how much the wall behind the target is too far for its landmarks to be read. So
robots part until they look from all sides, as agents in cyclic pursuit do (Marshall, Broucke and Francis, Formations
of vehicles in cyclic pursuit, IEEE Trans. Automatic Control 49(11), 2004), though none knows of an order.

The yaw leaves to the gimbal what it can reach, and turns along with the bearing: a gimbal turns in steps, and no sweep
outlasts one.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.barrier import Planar
from agent.capabilities.swim.pilot import Reference
from agent.capabilities.swim.surroundings import Surroundings, facing, known, sight_m, velocity_m_s, within_walls
from agent.core.config import Follow
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.core.target_state import TargetEstimate

SHARE = 0.9  # of an even spread: robots that want all of it push each other round for ever
DETOURS = (0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2, 1.6, -1.6)  # rad, the first of equals is taken
HIDDEN, REACH_1_M = 2.0, 5.0  # what a detour may cost, rad; the first detour pays from 8 cm of reach on
FAR_M, FAR_1_M = 1.9, 1.0  # of the wall behind the target, where landmarks are, from the robot; rad for each metre more
RING_M = 0.17  # of a robot, which hides what is behind it
ALONG = 0.7  # of the target's speed is swum ahead: it is known late, and turns
SURE_1_S = 0.5  # of the distance that is left where the target may be, swum in a second at most


class Pursuit(NamedTuple):
    """What is remembered between steps."""

    bearing: float  # of the target, from the robot, at the step before


def knows(what: Follow, around: Surroundings, now_ns: int) -> bool:
    """Whether there is anything to follow: somebody saw it of late, and it is clear on which side it is."""
    target = around.target
    return target is not None and known(target, now_ns) and target.sigma_m < what.standoff_m


def follow(
    what: Follow,
    target: TargetEstimate,
    pursuit: Pursuit | None,
    yaw: float,
    pose: Vector,
    around: Surroundings,
    now_ns: int,
) -> tuple[Reference, Pursuit]:
    """Where the robot shall be now, of a target that it knows. yaw: that it held until now, rad."""
    at_m, velocity = target.x_m[:2], velocity_m_s(target, now_ns)
    swims = ALONG * velocity[0], ALONG * velocity[1]
    pace = math.hypot(*swims)
    if pace > around.speed_m_s:
        swims = swims[0] * around.speed_m_s / pace, swims[1] * around.speed_m_s / pace
    place = place_around(at_m, what.standoff_m, pose, around)
    most_m_s = max(min(around.speed_m_s - pace, SURE_1_S * (what.standoff_m - target.sigma_m)), 0.0)
    bearing = math.atan2(at_m[1] - pose[1], at_m[0] - pose[0])
    to = Reference(
        place,
        wrap(facing(yaw if pursuit is None else yaw + wrap(bearing - pursuit.bearing), bearing)),
        swims,
        rate_rad_s=_rate(at_m, velocity, pose, around.velocity_m_s, what.standoff_m),
        most_m_s=most_m_s,
    )
    return to, Pursuit(bearing)


def place_around(target_m: Planar, standoff_m: float, pose: Vector, around: Surroundings) -> Planar:
    """The goal: of the places around the target the one that costs least."""
    mine = _bearing(target_m, (pose[0], pose[1]))
    middle = mine + 0.5 * _push(mine, [_bearing(target_m, other) for other in around.fellows_m])
    best, least = (pose[0], pose[1]), math.inf
    for detour in DETOURS:
        way = math.cos(middle + detour), math.sin(middle + detour)
        goal = within_walls((target_m[0] + standoff_m * way[0], target_m[1] + standoff_m * way[1]), around.tank_m)
        reach_m = abs(math.dist(goal, target_m) - standoff_m)
        hidden = _hidden(goal, target_m, (*around.robots_m, *around.screens_m))
        far_m = max(sight_m(goal, _bearing(goal, target_m), around.tank_m) - FAR_M, 0.0)
        cost = abs(detour) + HIDDEN * hidden + REACH_1_M * reach_m + FAR_1_M * far_m
        if cost < least:
            best, least = goal, cost
    return best


def _push(mine: float, others: list[float]) -> float:
    """By how much the others' bearings are too near to this robot's, rad, and to which side."""
    even = SHARE * 2.0 * math.pi / max(len(others) + 1, 3)
    gaps = [wrap(mine - other) for other in others]
    return math.fsum(math.copysign(max(0.0, even - abs(gap)), gap) for gap in gaps)


def _hidden(from_m: Planar, target_m: Planar, things_m: tuple[Planar, ...]) -> bool:
    """Whether a robot, or what hid the target lately, is in between."""
    x, y = target_m[0] - from_m[0], target_m[1] - from_m[1]
    length2 = max(x * x + y * y, 1e-12)
    for other in things_m:
        east, north = other[0] - from_m[0], other[1] - from_m[1]
        along = (east * x + north * y) / length2
        if 0.0 < along < 1.0 and math.hypot(east - along * x, north - along * y) < RING_M:
            return True
    return False


def _rate(at_m: Planar, velocity: Planar, pose: Vector, own: Planar, standoff_m: float) -> float:
    """Of the bearing, rad/s; nearer than the standoff it may be anything."""
    x, y = at_m[0] - pose[0], at_m[1] - pose[1]
    way2 = max(x * x + y * y, standoff_m * standoff_m)
    return (x * (velocity[1] - own[1]) - y * (velocity[0] - own[0])) / way2


def _bearing(from_m: Planar, to_m: Planar) -> float:
    if from_m == to_m:
        return 0.0
    return math.atan2(to_m[1] - from_m[1], to_m[0] - from_m[0])
