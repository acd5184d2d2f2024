"""What a robot swims so that its mass and drag can be read from the recording: two speeds, two turns, and coasts.

Legs along a line, first ahead and astern, then sideways; then turns on the spot. Each leg is an approach, a run at one
speed, and, from the middle on, a coast without any force: what slows it down then is drag alone.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.pilot import Reference
from agent.core.config import Trial
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector

TRIAL_NEAR_M, NEAR_RAD = 0.05, math.radians(5.0)  # of where a leg begins; nobody has to be there exactly
APPROACH_NS, RUN_NS, COAST_NS = 12_000_000_000, 9_000_000_000, 3_000_000_000  # at most; at most; always
QUARTER = 0.5 * math.pi  # of a turn, over which a turn runs


class Line(NamedTuple):
    """One leg along the line."""

    way: float  # 1: onwards, -1: back
    share: float  # of the trial's speed
    sideways: bool  # the hull across the line


class Spin(NamedTuple):
    """One leg on the spot."""

    rate_rad_s: float


def _lines(sideways: bool) -> tuple[Line, ...]:
    return tuple(Line(way, share, sideways) for way, share in ((1.0, 1.0), (-1.0, 0.4), (1.0, 0.4), (-1.0, 1.0)))


LEGS: tuple[Line | Spin, ...] = (*_lines(False), *_lines(True), Spin(0.4), Spin(-0.8), Spin(0.8), Spin(-0.4))


class Stage(NamedTuple):
    """How far a trial has come."""

    leg: int = 0
    coasts: bool = False
    runs: bool = False
    since_ns: int = 0
    yaw: float = 0.0  # at the start of a turn


def trial(what: Trial, stage: Stage, pose: Vector, now_ns: int) -> tuple[Reference, Stage]:
    """Where the robot shall be now; without legs left it stays in the middle, and is done."""
    stage = _next(what, stage, pose, now_ns)
    middle, heading = (what.x_m, what.y_m), math.radians(what.yaw_deg)
    if stage.leg >= len(LEGS):
        return Reference(middle, heading, done=True), stage
    leg = LEGS[stage.leg]
    if isinstance(leg, Spin):
        if not stage.runs:
            return Reference(middle, pose[2] if stage.coasts else heading, coast=stage.coasts), stage
        return Reference(middle, pose[2], rate_rad_s=leg.rate_rad_s), stage
    c, s = math.cos(heading), math.sin(heading)
    yaw = heading + (QUARTER if leg.sideways else 0.0)
    if not stage.runs and not stage.coasts:
        return Reference((what.x_m - leg.way * what.half_m * c, what.y_m - leg.way * what.half_m * s), yaw), stage
    along, v = _along(what, pose), leg.way * leg.share * what.speed_m_s
    at = what.x_m + along * c, what.y_m + along * s  # abreast of the robot: it is late for nothing
    return Reference(at, yaw, (v * c, v * s), coast=stage.coasts), stage


def _next(what: Trial, stage: Stage, pose: Vector, now_ns: int) -> Stage:
    if stage.leg >= len(LEGS):
        return stage
    leg = LEGS[stage.leg]
    since_ns = now_ns if stage.since_ns == 0 else stage.since_ns
    stage, passed_ns = stage._replace(since_ns=since_ns), now_ns - since_ns
    if stage.coasts:
        return Stage(stage.leg + 1, since_ns=now_ns) if passed_ns >= COAST_NS else stage
    if stage.runs:
        over = _has_run(what, leg, stage, pose) or passed_ns >= RUN_NS
        return Stage(stage.leg, coasts=True, since_ns=now_ns) if over else stage
    ready = _is_ready(what, leg, pose) or passed_ns >= APPROACH_NS
    return Stage(stage.leg, runs=True, since_ns=now_ns, yaw=pose[2]) if ready else stage


def _has_run(what: Trial, leg: Line | Spin, stage: Stage, pose: Vector) -> bool:
    if isinstance(leg, Spin):
        turned = wrap(pose[2] - stage.yaw)
        return turned * leg.rate_rad_s > 0.0 and abs(turned) >= QUARTER
    return leg.way * _along(what, pose) >= 0.0


def _is_ready(what: Trial, leg: Line | Spin, pose: Vector) -> bool:
    way, yaw = (0.0, 0.0) if isinstance(leg, Spin) else (-leg.way * what.half_m, QUARTER if leg.sideways else 0.0)
    heading = math.radians(what.yaw_deg)
    x, y = what.x_m + way * math.cos(heading), what.y_m + way * math.sin(heading)
    return math.hypot(x - pose[0], y - pose[1]) < TRIAL_NEAR_M and abs(wrap(heading + yaw - pose[2])) < NEAR_RAD


def _along(what: Trial, pose: Vector) -> float:
    """How far the robot is along the line, from the middle."""
    heading = math.radians(what.yaw_deg)
    return (pose[0] - what.x_m) * math.cos(heading) + (pose[1] - what.y_m) * math.sin(heading)
