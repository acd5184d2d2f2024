"""What may not be in a fleet file of robots that swim, or of moored ones that are told to."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import combinations

from agent.kernel.config import Behaviour, Fleet, Goto, Orbit
from agent.kernel.navigation.barrier import MARGIN_M, RINGS_M, WALL_M


def broken_swim_rules(fleet: Fleet) -> Iterator[tuple[str, str]]:
    """Every mistake as (key, what to change)."""
    if fleet.navigation is None:
        for name, robot in fleet.robot.items():
            if robot.behaviour is not None:
                yield f"robot.{name}.behaviour", "it is moored; add a table [navigation], or remove the behaviour"
        return
    if fleet.landmarks is None:
        yield "navigation", "robots that swim find themselves by landmarks; add a table [landmarks]"
    for name, robot in fleet.robot.items():
        if (wrong := _outside(fleet, robot.pose.x_m, robot.pose.y_m)) is not None:
            yield f"robot.{name}.pose", wrong
        if robot.behaviour is not None and (wrong := _wrong_way(fleet, robot.behaviour)) is not None:
            yield f"robot.{name}.behaviour", wrong
    for (a, one), (b, other) in combinations(fleet.robot.items(), 2):
        apart_m = math.hypot(one.pose.x_m - other.pose.x_m, one.pose.y_m - other.pose.y_m)
        if apart_m < RINGS_M + MARGIN_M:
            why = f"{apart_m:.2f} m from '{a}', and their thrusters touch at {RINGS_M} m; move one of them"
            yield f"robot.{b}.pose", why


def _wrong_way(fleet: Fleet, what: Behaviour) -> str | None:
    """Why a robot cannot do that in this tank; None where it can."""
    if isinstance(what, Goto):
        if what.depth_m is not None and what.depth_m > fleet.tank.surface_m:
            return f"{what.depth_m} m is below the floor; the water is {fleet.tank.surface_m} m deep"
        return _outside(fleet, what.x_m, what.y_m)
    if isinstance(what, Orbit):
        (x, y), r = (what.x_m, what.y_m), what.radius_m
        return _outside(fleet, x - r, y - r) or _outside(fleet, x + r, y + r)
    return None


def _outside(fleet: Fleet, x_m: float, y_m: float) -> str | None:
    """Why no robot swims there; None where it can."""
    length_m, breadth_m, _ = fleet.tank.size_m
    if WALL_M <= x_m <= length_m - WALL_M and WALL_M <= y_m <= breadth_m - WALL_M:
        return None
    return f"({x_m:.2f}, {y_m:.2f}) is less than {WALL_M} m from a wall, where no robot swims; write another place"
