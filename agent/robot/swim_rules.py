"""What may not be in a fleet file of robots that swim, or of moored ones that are told to."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

from agent.capabilities.swim.pilot import MARGIN_M, WALL_M
from agent.core.config import Behaviour, Fleet, Follow, Goto, Orbit, Robot, Search, Survey, Trial

ROUNDING_M = 1e-9  # what a centre less its radius may lack


def broken_swim_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    surveys = [name for name, robot in fleet.robot.items() if isinstance(robot.behaviour, Survey)]
    if fleet.coverage is None:
        for name in surveys:
            yield f"robot.{name}.behaviour", "nobody says what there is to see; add a table [coverage]"
    elif not surveys:
        yield "coverage", 'nobody surveys; give a robot the behaviour { kind = "survey" }, or remove the table'
    if fleet.navigation is None:
        for name, robot in fleet.robot.items():
            if robot.behaviour is not None and not isinstance(robot.behaviour, Survey):
                yield f"robot.{name}.behaviour", "it is moored; add a table [navigation], or remove the behaviour"
        return
    if fleet.landmarks is None:
        yield "navigation", "robots that swim find themselves by landmarks; add a table [landmarks]"
    for name, robot in fleet.robot.items():
        if (wrong := _outside(fleet, robot.pose.x_m, robot.pose.y_m)) is not None:
            yield f"robot.{name}.pose", wrong
        if robot.behaviour is not None and (wrong := wrong_way(fleet, robot.behaviour)) is not None:
            yield f"robot.{name}.behaviour", wrong
    for (a, one), (b, other) in combinations(fleet.robot.items(), 2):
        key = "behaviour" if isinstance(other.behaviour, Goto) else "pose"
        apart_m = math.dist(_goal(one), _goal(other))
        if apart_m < (least_m := fleet.navigation.limits.separation_m) + MARGIN_M:
            why = f"{apart_m:.2f} m from '{a}', and robots keep {least_m} m and a margin apart; move one of them"
            yield f"robot.{b}.{key}", why


def _goal(robot: Robot) -> tuple[float, float]:
    """Where it is told to be in the end; of other behaviours, where it begins."""
    there = robot.behaviour if isinstance(robot.behaviour, Goto) else robot.pose
    return there.x_m, there.y_m


def wrong_way(fleet: Fleet, what: Behaviour) -> str | None:
    """Why a robot cannot do that in this tank; None where it can."""
    if isinstance(what, Goto):
        if what.depth_m is not None and what.depth_m > fleet.tank.surface_m:
            return f"{what.depth_m} m is below the floor; the water is {fleet.tank.surface_m} m deep"
        return _outside(fleet, what.x_m, what.y_m)
    if isinstance(what, Follow | Search) and what.target not in fleet.target:
        return f"no target '{what.target}'; the file has {', '.join(fleet.target)}"
    if isinstance(what, Follow) and (wrong := _too_far(fleet, what)) is not None:
        return wrong
    if isinstance(what, Orbit | Trial | Search):
        assert fleet.navigation is not None
        if abs(what.speed_m_s) > (most := fleet.navigation.limits.speed_m_s):
            return f"{abs(what.speed_m_s)} m/s is faster than navigation.limits.speed_m_s, {most}; swim slower"
    if isinstance(what, Trial):
        heading = math.radians(what.yaw_deg)
        x, y = what.half_m * math.cos(heading), what.half_m * math.sin(heading)
        return _outside(fleet, what.x_m - x, what.y_m - y) or _outside(fleet, what.x_m + x, what.y_m + y)
    if isinstance(what, Orbit):
        (x, y), r = (what.x_m, what.y_m), what.radius_m
        return _outside(fleet, x - r, y - r) or _outside(fleet, x + r, y + r)
    return None


def _too_far(fleet: Fleet, what: Follow) -> str | None:
    """Why nobody can keep that distance from a target in the middle of the tank, on any side of it."""
    most_m = 0.5 * max(fleet.tank.size_m[:2]) - WALL_M
    if what.standoff_m <= most_m:
        return None
    return f"a standoff of {what.standoff_m} m does not fit into the tank; write {most_m:.2f} or less"


def _outside(fleet: Fleet, x_m: float, y_m: float) -> str | None:
    """Why no robot swims there; None where it can."""
    length_m, breadth_m, _ = fleet.tank.size_m
    if min(x_m, length_m - x_m, y_m, breadth_m - y_m) >= WALL_M - ROUNDING_M:
        return None
    return f"({x_m:.2f}, {y_m:.2f}) is less than {WALL_M} m from a wall, where no robot swims; write another place"
