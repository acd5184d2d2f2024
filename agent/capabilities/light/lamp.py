"""A robot's own lamp: what it is told, since when it rests, and what it can still give."""

from __future__ import annotations

from typing import NamedTuple

from agent.core.capability_messages import Why
from agent.core.control.pointing import SLEW_US_PER_S
from agent.core.step_io import Telemetry

DARK_NS = 150_000_000  # from a set-point to light or darkness: the line to the module, its loop, the lamp's driver
SERVO_NS = 300_000_000  # lag of a servo at the end of a turn, and what a small move does to the body
# How warm a lamp gets in water is assumed, not measured: as warm as it may be after three and a half minutes at full
# power, and two minutes until it has cooled by two thirds.
WARMS_S, COOLS_S = 100.0, 120.0
TOO_WARM = 1.0  # share of what it may be
FULL_V, EMPTY_V = 14.8, 13.2  # of four cells under light load; the control module calls 12 V low
LENDS_BELOW = 0.9  # of whichever load is more; above, a robot keeps its light for itself


class OrderedLight(NamedTuple):
    """How somebody has ordered a lamp to burn, until he orders otherwise."""

    light: float  # share of full power
    pan_deg: float
    tilt_deg: float


class LampControl(NamedTuple):
    """As commanded. Pulses are those of its gimbal, pan and tilt, us."""

    us: tuple[int, int]
    power: float = 0.0
    changes: int = 0  # commands that altered the light
    rests_ns: int = 0  # its gimbal
    steady_ns: int = 0  # gimbal and light
    warm: float = 0.0  # share of what it may be
    at_ns: int = 0  # of that

    def steady(self, now_ns: int) -> bool:
        return now_ns >= self.steady_ns


def command(lamp: LampControl, power: float, us: tuple[int, int], now_ns: int) -> LampControl:
    """The lamp told to burn like that. A turn in the dark is no change of light."""
    if (power, us) == (lamp.power, lamp.us):
        return lamp
    travel_us = max(abs(to - at) for to, at in zip(us, lamp.us, strict=True))
    rests_ns = lamp.rests_ns
    if travel_us:
        rests_ns = max(rests_ns, now_ns) + round(travel_us / SLEW_US_PER_S * 1e9) + SERVO_NS
    if power == lamp.power == 0.0:
        return lamp._replace(us=us, rests_ns=rests_ns)
    steady_ns = max(now_ns + DARK_NS, rests_ns if power else 0)
    return lamp._replace(power=power, us=us, changes=lamp.changes + 1, rests_ns=rests_ns, steady_ns=steady_ns)


def warmed(lamp: LampControl, now_ns: int) -> LampControl:
    """The lamp some time later: it warms with its power and cools with what it is."""
    dt_s = (now_ns - lamp.at_ns) * 1e-9 if lamp.at_ns else 0.0
    ends = lamp.power * COOLS_S / WARMS_S
    # Not exp, whose last bit differs between processors; steps are short.
    share = min(dt_s / COOLS_S, 1.0)
    return lamp._replace(warm=lamp.warm + (ends - lamp.warm) * share, at_ns=now_ns)


def load(lamp: LampControl, telemetry: Telemetry | None) -> float:
    """How near it is to a limit, of heat or of the battery: 0 to 1, in hundredths."""
    empty = 0.0 if telemetry is None else (FULL_V - telemetry.battery_v) / (FULL_V - EMPTY_V)
    return round(min(max(lamp.warm / TOO_WARM, empty, 0.0), 1.0), 2)


def cannot(has: bool, lamp: LampControl, telemetry: Telemetry | None, silent: bool) -> Why:
    """Why it must not burn at all, for itself or for others; empty: it may. silent: the control module is."""
    if not has:
        return "no lamp"
    if telemetry is None or silent or not telemetry.armed or telemetry.ladder > 0:
        return "off"
    if telemetry.battery_v < EMPTY_V:
        return "battery"
    return "heat" if lamp.warm >= TOO_WARM else ""
