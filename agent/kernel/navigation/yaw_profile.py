"""How a turn's reference goes: as fast as the limit allows, speeding up and braking evenly.

A robot that only steers for its goal brakes too early, for the gain that fixes from 0.2 s ago allow is small: the last
40 degrees of a turn take it 2 s. One that is told where to be meanwhile, and how fast, needs the gain for what goes
wrong only.
"""

from __future__ import annotations

import math
from typing import NamedTuple

EVEN_RAD_S2 = 1.5  # a fifth of what thrusters can do: what inertia and drag are not known to, the pilot has to mend


class YawMove(NamedTuple):
    """Of a way, at one moment: how much of it is done, and how that changes. rad, rad/s, rad/s^2."""

    way: float
    rate: float
    acceleration: float


def yaw_move(way: float, turn_rad_s: float, seconds: float) -> YawMove:
    """Where somebody is on a way (rad, either sign) so long after he began, at rest at both ends."""
    sign, length = math.copysign(1.0, way), abs(way)
    peak = min(turn_rad_s, math.sqrt(EVEN_RAD_S2 * length))  # a short way is over before that rate is reached
    if not peak > 0.0:
        return YawMove(0.0, 0.0, 0.0)
    ramp_s = peak / EVEN_RAD_S2
    all_s = length / peak + ramp_s
    left_s = all_s - seconds
    if left_s <= 0.0:
        return YawMove(way, 0.0, 0.0)
    if seconds < ramp_s:
        done, rate, even = 0.5 * EVEN_RAD_S2 * seconds * seconds, EVEN_RAD_S2 * seconds, EVEN_RAD_S2
    elif left_s < ramp_s:
        done, rate, even = length - 0.5 * EVEN_RAD_S2 * left_s * left_s, EVEN_RAD_S2 * left_s, -EVEN_RAD_S2
    else:
        done, rate, even = peak * (seconds - 0.5 * ramp_s), peak, 0.0
    return YawMove(sign * done, sign * rate, sign * even)
