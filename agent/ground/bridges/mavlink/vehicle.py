"""A robot's State as a vehicle: north, east, down, and the words of ArduSub. Pure, and without MAVLink's library.

North is y of the world frame, east is x, down is from the surface. Heading counts clockwise from north. Roll is as
ours; pitch is not: ours is positive with the bow down.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import UNSET

from agent.core.config import Robot
from agent.core.messages import State
from agent.core.status import FAILSAFE
from hw.firmware.failsafe import SURFACE

# Custom modes of ArduSub. Source: ArduPilot, ArduSub/mode.h.
ALT_HOLD, GUIDED, SURFACING = 2, 4, 9
# MAV_STATE. Source: MAVLink, common.xml.
STANDBY, ACTIVE, CRITICAL, EMERGENCY, POWEROFF = 3, 4, 5, 6, 7


class Vehicle(NamedTuple):
    """What a ground station is told of a robot. None: nobody knows, and nothing is sent that would have to say."""

    boot_ms: int  # since the agent's start
    armed: bool  # also where nobody knows, for whoever is about to reach into the water
    mode: int
    status: int
    north_m: float | None
    east_m: float | None
    place_sigma_m: float | None  # of what swims; None of what is moored: it was surveyed
    depth_m: float | None
    roll_rad: float | None
    pitch_rad: float | None
    yaw_rad: float | None  # clockwise from north, -pi to pi
    battery_v: float | None
    pressure_works: bool
    camera_works: bool


def vehicle(robot: Robot, state: State) -> Vehicle:
    """`robot`: its table in the fleet file, which says where a moored one hangs."""
    where = robot.pose if state.whereabouts is UNSET else state.whereabouts
    surfaces = f"{FAILSAFE} {SURFACE}" in state.faults or (
        state.ordered is not UNSET and any(each.endswith(": surface") for each in state.ordered)
    )
    return Vehicle(
        boot_ms=max(0, state.sent_ns - state.incarnation) // 1_000_000 % 2**32,
        armed=state.armed is not False,
        mode=SURFACING if surfaces else _mode(state),
        status=_status(state, surfaces),
        north_m=where.y_m if where else None,
        east_m=where.x_m if where else None,
        place_sigma_m=state.whereabouts.place_sigma_m if state.whereabouts else None,
        depth_m=state.depth_m,
        roll_rad=None if state.roll_deg is None else math.radians(state.roll_deg),
        pitch_rad=None if state.pitch_deg is None else -math.radians(state.pitch_deg),
        yaw_rad=math.remainder(math.radians(90.0 - where.yaw_deg), math.tau) if where else None,
        battery_v=None if state.battery_v is UNSET else state.battery_v,
        pressure_works=state.armed is not None and state.depth_m is not None,
        camera_works="no frames" not in state.faults,
    )


def _mode(state: State) -> int:
    """Guided: a robot that swims and does more than to hold its place."""
    return ALT_HOLD if state.behaviour is UNSET or state.behaviour == "hold" else GUIDED


def _status(state: State, surfaces: bool) -> int:
    if state.mode in ("failed", "stopped"):
        return EMERGENCY if state.mode == "failed" else POWEROFF
    if surfaces or state.mode == "degraded" or state.armed is None:
        return CRITICAL
    return ACTIVE if state.armed else STANDBY
