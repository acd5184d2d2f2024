"""What a behaviour may know beside the robot's pose: the tank, the target it is about, and who else is about that."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.barrier import MARGIN_M, STILL, WALL_M, Planar
from agent.core.linear_algebra import wrap
from agent.core.target_state import TargetEstimate

SEEN_NS = 20_000_000_000  # a glance at landmarks takes seconds, and targets take turns: unseen for longer is unknown
ANYWHERE_M = 0.5  # sigma of a target that nobody sees: too much water to look at from one place
GIMBAL_RAD = math.radians(50.0)  # to either side: beyond, the body turns after the gimbal
# Of a wall ahead: from nearer no whole landmark fits into the picture, or one, and there is little else to go by.
SIGHT_M = 0.8
SPEED_NS = 3_000_000_000  # unseen for so long, a target that moved may have turned


def known(target: TargetEstimate | None, now_ns: int) -> bool:
    """Whether anybody has seen it of late, and it cannot be anywhere by now."""
    if target is None:
        return False
    unseen_ns = now_ns - target.seen_ns
    return unseen_ns <= SPEED_NS or (unseen_ns <= SEEN_NS and target.sigma_m < ANYWHERE_M)


def velocity_m_s(target: TargetEstimate, now_ns: int) -> Planar:
    """Over ground, as long as somebody sees that it still moves so."""
    return (target.v_m_s[0], target.v_m_s[1]) if now_ns - target.seen_ns <= SPEED_NS else STILL


class Surroundings(NamedTuple):
    """At one moment."""

    tank_m: Planar  # length and breadth
    speed_m_s: float  # that the robot may swim at
    velocity_m_s: Planar = STILL  # at which it swims now, world frame
    target: TargetEstimate | None = None  # None: nobody ever said where it is
    swims: bool = False  # the target that it is about, by itself
    sees: bool = False  # the robot's own camera has the target in view
    looks: bool = False  # its gaze still goes round where the target was last
    fellows_m: tuple[Planar, ...] = ()  # robots that say they do the same about the same target
    screens_m: tuple[Planar, ...] = ()  # what hid the target lately, about there
    robots_m: tuple[Planar, ...] = ()  # all that say where they are
    station: tuple[Planar, float] | None = None  # where a survey looks from, and how it is turned there, rad


def within_walls(place_m: Planar, tank_m: Planar) -> Planar:
    """The nearest place that a robot may be told to swim to."""
    clear_m = WALL_M + MARGIN_M
    x, y = (min(max(at, clear_m), max(side - clear_m, clear_m)) for at, side in zip(place_m, tank_m, strict=True))
    return x, y


def walled_in(place_m: Planar, yaw: float, tank_m: Planar) -> bool:
    """Whether who looks that way from there has a wall before it."""
    return sight_m(place_m, yaw, tank_m) < SIGHT_M


def sight_m(place_m: Planar, yaw: float, tank_m: Planar) -> float:
    """How far it is to the wall, that way from there."""
    ways = zip(place_m, (math.cos(yaw), math.sin(yaw)), tank_m, strict=True)
    return min((side - at if way > 0.0 else at) / abs(way) if way else math.inf for at, way, side in ways)


def facing(yaw: float, bearing: float) -> float:
    """The yaw nearest to the wanted one from which the gimbal reaches what is at that bearing."""
    off = wrap(bearing - yaw)
    return yaw if abs(off) <= GIMBAL_RAD else wrap(bearing - math.copysign(GIMBAL_RAD, off))
