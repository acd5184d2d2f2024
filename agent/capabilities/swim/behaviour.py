"""What a robot is told to do, as a reference for the pilot at every moment.

A behaviour starts with `start`, and is asked for its `reference` at each step. Yaw is counted from where the robot was
put into the water, over all turns, and kept within one turn either way: the tether would wind up.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.barrier import Planar
from agent.capabilities.swim.follow import Pursuit, follow, knows
from agent.capabilities.swim.pilot import Reference
from agent.capabilities.swim.search import Hunt, search
from agent.capabilities.swim.surroundings import Surroundings, facing, walled_in
from agent.capabilities.swim.trial import Stage, trial
from agent.core.config import Behaviour, Follow, Goto, Hold, Orbit, Search, Survey, Trial, Turn
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector

THERE_M, THERE_RAD, THERE_NS = 0.02, math.radians(2.0), 1_000_000_000  # arrived: so near, for so long
NEAR_M = 0.10  # to the goal: the way has no direction any more
MOST_TURNED_RAD = 2.0 * math.pi  # either way
SLACK_RAD = math.radians(10.0)  # an orbit turns round so far before that, for the body lags and swings
STRIDE_RAD = math.radians(90.0)  # of a reference ahead of the body: which way round stays clear


class Progress(NamedTuple):
    """What a behaviour remembers between steps."""

    since_ns: int
    from_m: Planar  # where it started, or what it holds
    yaw: float  # to keep where the behaviour says nothing of yaw, rad
    turned: float  # by how much the body is turned since it was put into the water, rad, over all turns
    heading: float  # the yaw that `turned` was last counted at
    turned_first: float  # `turned` at the start
    there_ns: int | None = None  # since when it is where it shall be
    stage: Stage = Stage()  # of a trial
    pursuit: Pursuit | None = None  # of a target that is followed
    hunt: Hunt = Hunt()  # for one that nobody knows


def start(pose: Vector, turned: float, now_ns: int, to: Vector | None = None) -> Progress:
    """pose: x, y, yaw, and what Hold holds, unless that is given: `to`. turned: of the behaviour before
    (Progress.turned), 0 for the first."""
    x, y, yaw = pose if to is None else to
    return Progress(now_ns, (x, y), yaw, turned, pose[2], turned)


def reference(
    what: Behaviour,
    progress: Progress,
    pose: Vector,
    now_ns: int,
    watched_m: Planar | None = None,
    around: Surroundings | None = None,
    tank_m: Planar | None = None,
) -> tuple[Reference, Progress]:
    """Where the robot shall be now. watched_m: the target, which Goto faces unless it was given a yaw. Hold turns off
    its yaw as far as the gimbal needs, to keep the target in sight: the gimbal first, then the body. around: what
    Follow and Search go by. tank_m: length and breadth; who is free to choose looks at no near wall.
    """
    turned = progress.turned + wrap(pose[2] - progress.heading)
    progress = progress._replace(turned=turned, heading=pose[2])
    match what:
        case Hold():
            to = Reference(progress.from_m, in_sight(progress.yaw, pose, watched_m))
        case Turn():
            to = Reference(progress.from_m, math.radians(what.yaw_deg))
        case Goto():
            progress = progress._replace(yaw=_yaw_of_way(what, progress, pose, watched_m, tank_m))
            to = Reference((what.x_m, what.y_m), progress.yaw, depth_m=what.depth_m)
        case Orbit():
            to = _on_orbit(what, progress, now_ns)
        case Trial():
            to, stage = trial(what, progress.stage, pose, now_ns)
            progress = progress._replace(stage=stage)
        case Survey():
            if around is not None and around.station is not None:
                progress = progress._replace(from_m=around.station[0], yaw=around.station[1])
            to = Reference(progress.from_m, progress.yaw)
        case Follow() | Search():
            assert around is not None
            to, progress = _about_a_target(what, progress, pose, around, now_ns)
    there_ns = _there_since(to, progress, pose, now_ns) if isinstance(what, Goto | Turn) else None
    done = to.done or (there_ns is not None and now_ns - there_ns >= THERE_NS)
    return to._replace(yaw=unwound(to.yaw, pose[2], turned), done=done), progress._replace(there_ns=there_ns)


def effective(what: Behaviour, hunt: Hunt, around: Surroundings | None, now_ns: int) -> Behaviour:
    """What is done: Follow searches for a target that nobody knows, where it is told to, and else holds; Search holds
    once it is done."""
    if isinstance(what, Follow) and around is not None and not knows(what, around, now_ns):
        what = Search(target=what.target) if what.search else Hold()
    if isinstance(what, Search) and around is not None and hunt.over(around, now_ns):
        return Hold()
    return what


def _about_a_target(
    what: Follow | Search, progress: Progress, pose: Vector, around: Surroundings, now_ns: int
) -> tuple[Reference, Progress]:
    match effective(what, progress.hunt, around, now_ns):
        case Follow() as told if around.target is not None:
            target = around.target
            to, pursuit = follow(told, target, progress.pursuit, progress.yaw, pose, around, now_ns)
            return to, progress._replace(from_m=pose[:2], yaw=to.yaw, pursuit=pursuit, hunt=Hunt())
        case Search() as told:
            to, hunt = search(told, progress.hunt, progress.yaw, pose, around, now_ns)
            return to, progress._replace(from_m=pose[:2], yaw=to.yaw, pursuit=None, hunt=hunt)
    hunt = progress.hunt._replace(done=isinstance(what, Search))
    at_m = None if around.target is None else around.target.x_m[:2]
    to = Reference(progress.from_m, in_sight(progress.yaw, pose, at_m), done=hunt.done)
    return to, progress._replace(pursuit=None, hunt=hunt)


def unwound(wanted: float, yaw: float, turned: float) -> float:
    """A yaw to steer for: the wanted one; where the short way there would wind the tether up, one on the long way."""
    short = wrap(wanted - yaw)
    if abs(turned + short) <= MOST_TURNED_RAD:
        return wanted
    return wrap(yaw - math.copysign(min(STRIDE_RAD, 2.0 * math.pi - abs(short)), short))


def in_sight(yaw: float, pose: Vector, watched_m: Planar | None) -> float:
    """The yaw nearest to the wanted one from which the gimbal reaches the target."""
    if watched_m is None:
        return yaw
    return facing(yaw, math.atan2(watched_m[1] - pose[1], watched_m[0] - pose[0]))


def _yaw_of_way(what: Goto, progress: Progress, pose: Vector, watched_m: Planar | None, tank_m: Planar | None) -> float:
    if what.yaw_deg is not None:
        return math.radians(what.yaw_deg)
    if watched_m is not None:
        return math.atan2(watched_m[1] - pose[1], watched_m[0] - pose[0])
    x, y = what.x_m - pose[0], what.y_m - pose[1]
    yaw = math.atan2(y, x) if math.hypot(x, y) > NEAR_M else progress.yaw
    if tank_m is None or not (walled_in(pose[:2], yaw, tank_m) or walled_in((what.x_m, what.y_m), yaw, tank_m)):
        return yaw
    return math.atan2(0.5 * tank_m[1] - pose[1], 0.5 * tank_m[0] - pose[0])


def _on_orbit(what: Orbit, progress: Progress, now_ns: int) -> Reference:
    """p = c + R (cos th, sin th), th growing by V / R; back again where the tether has had its turn."""
    east, north = progress.from_m[0] - what.x_m, progress.from_m[1] - what.y_m
    first = math.atan2(north, east)
    facing = progress.turned_first + wrap(first + math.pi - progress.yaw)  # turned by so much, once it looks inwards
    if abs(facing) > MOST_TURNED_RAD:  # it has come there on the long way
        facing -= math.copysign(2.0 * math.pi, facing)
    most, rate = MOST_TURNED_RAD - SLACK_RAD, what.speed_m_s / what.radius_m
    way, sign = _to_and_fro(rate * (now_ns - progress.since_ns) * 1e-9, -most - facing, most - facing)
    c, s = math.cos(first + way), math.sin(first + way)
    v, pull = sign * what.speed_m_s, what.speed_m_s * what.speed_m_s / what.radius_m
    return Reference(
        (what.x_m + what.radius_m * c, what.y_m + what.radius_m * s),
        wrap(first + way + math.pi),
        (-v * s, v * c),
        (-pull * c, -pull * s),
        sign * rate,
    )


def _to_and_fro(way: float, lowest: float, highest: float) -> tuple[float, float]:
    """Where somebody is after a way from 0 who turns round at both ends, and whether he goes as he set out: +1, -1."""
    if lowest <= way <= highest:
        return way, 1.0
    span = highest - lowest
    along = math.fmod(way - lowest, 2.0 * span)
    along += 2.0 * span if along < 0.0 else 0.0
    return (lowest + along, 1.0) if along <= span else (highest - (along - span), -1.0)


def _there_since(to: Reference, progress: Progress, pose: Vector, now_ns: int) -> int | None:
    off_m = math.hypot(to.place_m[0] - pose[0], to.place_m[1] - pose[1])
    if off_m > THERE_M or abs(wrap(to.yaw - pose[2])) > THERE_RAD:
        return None
    return now_ns if progress.there_ns is None else progress.there_ns
