"""Look for a target that nobody knows: first around where it was last, then along lanes through the robot's own part
of the tank.

That part is its Voronoi cell among the robots that search with it, drawn in by what is kept clear of walls (Cortes,
Martinez, Karatas and Bullo, Coverage control for mobile sensing networks, IEEE Trans. Robotics and Automation 20(2),
2004). It is cut when the robot begins and again when another begins or falls silent, not while all swim on: lanes that
moved along with everybody would never end. The camera's gaze goes all around meanwhile (control/roam.py). Who has the
target in view waits where it is, for a sweep wants a robot at rest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.barrier import Planar
from agent.capabilities.swim.lanes import cell, lanes
from agent.capabilities.swim.pilot import Reference
from agent.capabilities.swim.surroundings import Surroundings, facing, known, within_walls
from agent.core.config import Search
from agent.core.messages import Vector

REACHED_M = 0.06  # of an end of a lane: nobody has to be there exactly
MIDDLE_M = 0.3  # of the tank: nearer, it is on no side
TURNS_RAD_S = 0.3  # what a frame showed 0.2 s ago is still in view when that is known
WAITS_NS = 2_500_000_000  # after the target was in view: for so long the gimbal turns to it, and looks


class Hunt(NamedTuple):
    """How far a search has come."""

    way: tuple[Planar, ...] = ()  # ends of lanes, in the order in which they are swum
    next: int = 0
    split: int = 0  # among how many the tank was divided
    waits_m: Planar | None = None  # where it stopped, to look or to measure
    seen_ns: int | None = None  # when the target was last in view
    done: bool = False

    def over(self, around: Surroundings, now_ns: int) -> bool:
        """Whether the target is known by now, or was once since the search began."""
        return self.done or known(around.target, now_ns)


def search(
    what: Search, hunt: Hunt, yaw: float, pose: Vector, around: Surroundings, now_ns: int
) -> tuple[Reference, Hunt]:
    """Where the robot shall be now. yaw: that it held until now, rad."""
    here = pose[0], pose[1]
    if around.sees:
        hunt = hunt._replace(seen_ns=now_ns)
    if around.looks or (hunt.seen_ns is not None and now_ns - hunt.seen_ns < WAITS_NS):
        if hunt.waits_m is None:
            hunt, yaw = hunt._replace(waits_m=within_walls(here, around.tank_m)), pose[2]
        if around.looks and around.target is not None:
            x, y = around.target.x_m[0] - here[0], around.target.x_m[1] - here[1]
            yaw = facing(yaw, math.atan2(y, x))
        return Reference(hunt.waits_m or here, yaw), hunt
    hunt = _next(what, hunt._replace(waits_m=None), here, around)
    goal = hunt.way[hunt.next]
    if around.swims:  # it may come from anywhere: the wall behind the robot is where it is not
        ahead_m, least_m = (0.5 * around.tank_m[0], 0.5 * around.tank_m[1]), MIDDLE_M
    else:
        ahead_m, least_m = goal, REACHED_M
    x, y = ahead_m[0] - here[0], ahead_m[1] - here[1]
    yaw = math.atan2(y, x) if math.hypot(x, y) > least_m else yaw
    return Reference(goal, yaw, most_m_s=what.speed_m_s, most_rad_s=TURNS_RAD_S), hunt


def _next(what: Search, hunt: Hunt, here: Planar, around: Surroundings) -> Hunt:
    """With a goal that is not reached yet; a new way where there is none, or others divide the tank."""
    split = len(around.fellows_m) + 1
    if hunt.next < len(hunt.way) and math.dist(hunt.way[hunt.next], here) < REACHED_M:
        hunt = hunt._replace(next=hunt.next + 1)
    if hunt.next < len(hunt.way) and hunt.split == split:
        return hunt
    ways = lanes(cell(here, around.fellows_m, around.tank_m), what.lane_m, here)
    return hunt._replace(way=ways or (within_walls(here, around.tank_m),), next=0, split=split)
