"""Fields of the wire's frames (hw.firmware.wire) from our messages, and our messages from such fields."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

from msgspec import UNSET

from agent.core.step_io import SetPoint, Telemetry
from hw.firmware import wire

TTL_MS = 500  # of a set-point; the board holds position after it

Level = Literal["info", "warning", "error"]
LEVELS: tuple[Level, ...] = ("info", "warning", "error")  # in the order of wire.INFO ...


class StatusText(NamedTuple):
    """A line for people, from the board or about it."""

    level: Level
    text: str


class Greeting(NamedTuple):
    """Who the board says it is."""

    build: str
    uid: str  # of the chip, hexadecimal
    boot_id: int
    reset_cause: int  # wire.POWER_ON ...
    parameters_crc: int  # parameters.crc of the values in force
    capabilities: int  # bits wire.CAN_...


def set_point_fields(asked: SetPoint, now_ns: int) -> tuple[int, ...]:
    """Fields of a SETPOINT; what is beyond the wire's range is clipped."""
    i16 = wire.fixed
    return (
        i16(asked.depth_m, 1e4),
        i16(asked.roll_deg, 100),
        i16(asked.pitch_deg, 100),
        i16(asked.force_n[0], 1e3),
        i16(asked.force_n[1], 1e3),
        i16(asked.yaw_moment_nm, 1e4),
        *(i16(us, 1, 0, 65535) for us in asked.servos_us),
        i16(asked.light, 1000, 0, 1000),
        wire.VALID_ALL,
        TTL_MS,
        now_ns // 1_000_000 & 0xFFFFFFFF,
    )


class TelemetryFrame(NamedTuple):
    telemetry: Telemetry
    greeted: bool  # the board knows us; not so after a restart
    set_point_seq: int  # number of the frame that brought the set-point in force


def telemetry_frame(fields: Sequence[int], now_ns: int, rate_cdeg_s: int = wire.NO_RATE) -> TelemetryFrame:
    """A TELEM that arrived at now_ns, without its last field, which is rate_cdeg_s; or a TELEM_1."""
    t_us, state, ladder, flags, *rest = fields
    zeta, (roll, pitch, depth), pulses, servos = rest[0:4], rest[4:7], rest[10:18], rest[18:22]
    _light, battery_mv, _saturated, _bad, set_point_seq, _dirty, loop_us = rest[22:]
    telemetry = Telemetry(
        t_ns=now_ns,
        board_us=t_us,
        depth_m=depth * 1e-4,
        roll_deg=roll * 1e-2,
        pitch_deg=pitch * 1e-2,
        sensor_depth_m=tuple(0.1 * z / wire.PA_PER_M for z in zeta),
        pulses_us=tuple(pulses),  # type: ignore[arg-type]
        servos_us=tuple(servos),  # type: ignore[arg-type]
        battery_v=battery_mv * 1e-3,
        armed=state == wire.ARMED,
        ladder=ladder,
        flags=flags,
        loop_us=loop_us,
        rate_rad_s=UNSET if rate_cdeg_s == wire.NO_RATE else math.radians(rate_cdeg_s * 1e-2),
    )
    return TelemetryFrame(telemetry, bool(flags & wire.FLAG_HELLO), set_point_seq)


def log_line(level: int, text: bytes) -> StatusText:
    """The line of a LOG."""
    return StatusText(LEVELS[min(level, 2)], f"board: {text.decode(errors='replace')}")


def event_line(code: int, before: int, after: int, severity: int, arg: int) -> StatusText:
    """The line of an EVENT, but for a refusal to arm."""
    reason = wire.REASONS[arg] if 0 <= arg < len(wire.REASONS) else f"reason {arg}"
    ladder = f"failsafe level {before} -> {after}: {reason}" if after else f"failsafe over, it was level {before}"
    text = {
        wire.EV_BOOT: "booted",
        wire.EV_ARMED: "armed",
        wire.EV_DISARMED: f"disarmed: {reason}",
        wire.EV_LADDER: ladder,
    }.get(code, f"event {code}")
    return StatusText(LEVELS[min(severity, 2)], f"board: {text}")
