"""A vehicle as messages of MAVLink. Pure; what is not known is marked as such, or left out. Source: common.xml."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.core.messages import Level
from agent.ground.bridges.mavlink.vehicle import Vehicle

EARTH_M = 6_378_137.0  # equatorial radius of WGS84
NONE16 = 2**16 - 1  # not known
PRESSURE, CAMERA, MOTORS = (
    mavlink.MAV_SYS_STATUS_SENSOR_ABSOLUTE_PRESSURE,
    mavlink.MAV_SYS_STATUS_SENSOR_VISION_POSITION,
    mavlink.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS,
)
SEVERITY: dict[Level, int] = {
    "info": mavlink.MAV_SEVERITY_INFO,
    "warning": mavlink.MAV_SEVERITY_WARNING,
    "error": mavlink.MAV_SEVERITY_ERROR,
}
TEXT_BYTES = 50  # of one STATUSTEXT
NO_FIX, STATIC = mavlink.GPS_FIX_TYPE_NO_FIX, mavlink.GPS_FIX_TYPE_STATIC


class Origin(NamedTuple):
    """Where on earth the tank's corner is said to be: ground stations want to draw a map."""

    latitude_deg: float
    longitude_deg: float

    def place(self, north_m: float, east_m: float) -> tuple[int, int]:
        """Latitude and longitude, 1e-7 degrees."""
        latitude = self.latitude_deg + math.degrees(north_m / EARTH_M)
        longitude = self.longitude_deg + math.degrees(east_m / EARTH_M / math.cos(math.radians(self.latitude_deg)))
        return round(latitude * 1e7), round(longitude * 1e7)


def heartbeat(v: Vehicle) -> Any:
    base = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (mavlink.MAV_MODE_FLAG_SAFETY_ARMED if v.armed else 0)
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_SUBMARINE, mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, base, v.mode, v.status, 3
    )


def each_second(v: Vehicle, origin: Origin) -> Iterator[Any]:
    """Beside the heartbeat: how its parts are, and how surely it knows where it is."""
    enabled = PRESSURE | CAMERA | (MOTORS if v.armed else 0)
    health = MOTORS | (PRESSURE if v.pressure_works else 0) | (CAMERA if v.camera_works else 0)
    parts = (PRESSURE | CAMERA | MOTORS, enabled, health)
    battery_mv = NONE16 if v.battery_v is None else round(1000.0 * v.battery_v)
    yield mavlink.MAVLink_sys_status_message(*parts, 0, battery_mv, -1, -1, 0, 0, 0, 0, 0, 0)
    if v.north_m is None or v.east_m is None:
        yield mavlink.MAVLink_gps_raw_int_message(0, NO_FIX, 0, 0, 0, NONE16, NONE16, NONE16, NONE16, 255)
        return
    moored = v.place_sigma_m is None
    yield mavlink.MAVLink_gps_raw_int_message(
        v.boot_ms * 1000,
        STATIC if moored else mavlink.GPS_FIX_TYPE_3D_FIX,
        *origin.place(v.north_m, v.east_m),
        -round(1000.0 * (v.depth_m or 0.0)),
        NONE16,  # dilutions of precision, speed and course
        NONE16,
        NONE16,
        NONE16,
        255,  # satellites
        h_acc=0 if v.place_sigma_m is None else round(1000.0 * v.place_sigma_m),
    )


def each_state(v: Vehicle, origin: Origin) -> Iterator[Any]:
    """How it hangs, where it is. Rates are not known, and 0: these messages have no word for that."""
    if v.roll_rad is not None and v.pitch_rad is not None and v.yaw_rad is not None:
        yield mavlink.MAVLink_attitude_message(v.boot_ms, v.roll_rad, v.pitch_rad, v.yaw_rad, 0.0, 0.0, 0.0)
    if v.depth_m is None:
        return
    heading_deg = None if v.yaw_rad is None else math.degrees(v.yaw_rad) % 360.0
    if v.north_m is not None and v.east_m is not None:
        down_mm = round(1000.0 * v.depth_m)
        heading = NONE16 if heading_deg is None else round(100.0 * heading_deg) % 36000
        place = origin.place(v.north_m, v.east_m)
        yield mavlink.MAVLink_global_position_int_message(v.boot_ms, *place, -down_mm, -down_mm, 0, 0, 0, heading)
        yield mavlink.MAVLink_local_position_ned_message(v.boot_ms, v.north_m, v.east_m, v.depth_m, 0.0, 0.0, 0.0)
    if heading_deg is not None:
        yield mavlink.MAVLink_vfr_hud_message(0.0, 0.0, round(heading_deg) % 360, 0, -v.depth_m, 0.0)


def global_origin(origin: Origin) -> Any:
    return mavlink.MAVLink_gps_global_origin_message(*origin.place(0.0, 0.0), 0)


def version() -> Any:
    """What can be asked of us. No number of ArduSub's: it is none."""
    can = mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2 | mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    none = (0,) * 8
    return mavlink.MAVLink_autopilot_version_message(can, 0, 0, 0, 0, none, none, none, 0, 0, 0)


def status_texts(level: Level, text: str, number: int) -> Iterator[Any]:
    """A line for people, in as many pieces as it needs; `number` tells the pieces of one line from another's."""
    line = text.encode("utf-8", errors="replace").replace(b"\0", b" ")
    pieces = [line[at : at + TEXT_BYTES] for at in range(0, len(line), TEXT_BYTES)]
    whole = len(pieces) == 1
    if pieces and len(pieces[-1]) == TEXT_BYTES and not whole:
        pieces.append(b"")  # the end of a line is a piece that is not full
    for index, piece in enumerate(pieces):
        yield mavlink.MAVLink_statustext_message(SEVERITY[level], piece, 0 if whole else number % NONE16 + 1, index)
