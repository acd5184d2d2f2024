"""Where servos stand that are told another angle at each step: behind what they are told, by their lag.

    dm/dt = (c - m) / tau,  |dm/dt| <= slew

Between two set-points c is constant, so that m has a closed form: at full speed while |c - m| > slew tau, then
(c - m) e^(-t/tau). Servos do not say where they are, and tau differs from one to the other: what it leaves open is its
uncertainty times the rate.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from agent.core.control.pointing import SLEW_US_PER_S
from agent.core.savepoint import Revertible

# Of the way through host and module, 20 ms at most each, and of a small digital servo under a camera's load.
SERVO_LAG_S = 0.06
LAG_SIGMA_S = 0.025
THERE_US = 5.0  # half a degree: a jump is over
SETTLED = 4.0  # lags after which it is, too, of one that is to turn on
KEEP_NS = 6_000_000_000  # as long as poses are kept

Pulses = tuple[float, float]  # pan and tilt, us


class Stand(NamedTuple):
    """Of both servos at one moment."""

    told_ns: int  # when the set-point came that they are on the way to
    us: Pulses
    sigma_us: float  # what the lag leaves open, of the one that turns faster; inf after a jump: full speed is not known


class Leg(NamedTuple):
    """From one set-point to the next."""

    told_ns: int
    from_us: Pulses
    to_us: Pulses
    jumps_until_ns: int = 0  # farther than at full speed; a swift servo is there long before a slow one


class ServoPath(Revertible):
    """Of the last seconds in which each step had a set-point of its own."""

    def __init__(self) -> None:
        self._legs: deque[Leg] = deque()

    def begin(self, at_us: Pulses) -> None:
        """They stand there when the next set-point comes."""
        self._legs.append(Leg(0, at_us, at_us))

    def add(self, told_ns: int, to_us: Pulses) -> None:
        """Told at that moment. There was a `begin`."""
        last = self._legs[-1]
        here = last.from_us if last.told_ns == 0 else _both(last, told_ns)
        if last.told_ns == 0:
            self._legs.pop()
        still = _left_us(last.to_us, here) > THERE_US
        until_ns = last.jumps_until_ns if still and last.jumps_until_ns > told_ns else 0
        left_us = _left_us(to_us, here)
        if left_us > SLEW_US_PER_S * SERVO_LAG_S:
            until_ns = told_ns + round((left_us / SLEW_US_PER_S + SETTLED * SERVO_LAG_S) * 1e9)
        self._legs.append(Leg(told_ns, here, to_us, until_ns))
        while self._legs[0].told_ns < told_ns - KEEP_NS:
            self._legs.popleft()

    def at(self, t_ns: int) -> Stand | None:
        """None: before the first set-point that is remembered."""
        for leg in reversed(self._legs):
            if 0 < leg.told_ns <= t_ns:
                here = _both(leg, t_ns)
                left_us = _left_us(leg.to_us, here)
                swift = t_ns < leg.jumps_until_ns and left_us > THERE_US
                return Stand(leg.told_ns, here, math.inf if swift else LAG_SIGMA_S * left_us / SERVO_LAG_S)
        return None


def _both(leg: Leg, t_ns: int) -> Pulses:
    seconds = (t_ns - leg.told_ns) * 1e-9
    return _after(leg.from_us[0], leg.to_us[0], seconds), _after(leg.from_us[1], leg.to_us[1], seconds)


def _left_us(to_us: Pulses, here_us: Pulses) -> float:
    return max(abs(c - m) for c, m in zip(to_us, here_us, strict=True))


def _after(from_us: float, to_us: float, seconds: float) -> float:
    way_us = to_us - from_us
    swift_s = max(abs(way_us) / SLEW_US_PER_S - SERVO_LAG_S, 0.0)  # at full speed
    if seconds <= swift_s:
        return from_us + math.copysign(SLEW_US_PER_S * seconds, way_us)
    left_us = abs(way_us) - SLEW_US_PER_S * swift_s
    return to_us - math.copysign(left_us * math.exp(-(seconds - swift_s) / SERVO_LAG_S), way_us)
