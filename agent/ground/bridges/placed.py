"""Where a robot's body is and how it is turned, as it says itself: for languages whose world is like ours.

That is z up, x ahead and y to the left: ROS's REP 103, ISO 8855.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import UNSET

from agent.core.config import Fleet
from agent.core.messages import State, Vector

WORLD = "world"  # name of the world frame, there
Quaternion = tuple[float, float, float, float]  # x, y, z, w


class Placed(NamedTuple):
    place_m: Vector  # world frame
    turned: Quaternion  # of the body in the world


def placed(fleet: Fleet, state: State) -> Placed | None:
    """None where it does not know all of that."""
    where = fleet.robot[state.robot].pose if state.whereabouts is UNSET else state.whereabouts
    if where is None or state.depth_m is None or state.roll_deg is None or state.pitch_deg is None:
        return None
    turned = quaternion(*map(math.radians, (state.roll_deg, state.pitch_deg, where.yaw_deg)))
    return Placed((where.x_m, where.y_m, fleet.tank.surface_m - state.depth_m), turned)


def quaternion(roll: float, pitch: float, yaw: float) -> Quaternion:
    """A turn by yaw about z, then by pitch about the new y, then by roll about the new x; radians."""
    (sr, cr), (sp, cp), (sy, cy) = ((math.sin(angle / 2.0), math.cos(angle / 2.0)) for angle in (roll, pitch, yaw))
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
