"""Whether a module's gyro can be believed: what it says is checked before it becomes a measurement.

A gyro that works is never still: its noise is a few of the wire's steps, so that a value which comes again and again
for a second is no measurement. One at the end of its scale turns faster than it can say.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import UNSET

from agent.core.step_io import Telemetry
from agent.core.step_transaction import Revertible

FULL_SCALE_RAD_S = math.radians(249.0)  # of 250 deg/s, hw/firmware/gyro.py
LATE_NS = 10_000_000  # its low-pass of 25 Hz, and half a cycle of 10 ms until it is told
STUCK_NS, STUCK_READINGS = 1_000_000_000, 10
SILENT_NS = 1_000_000_000  # without a reading that can be used: nothing to be told of a lost frame or two


class Rate(NamedTuple):
    """A yaw rate that can be believed, and when it was so."""

    t_ns: int
    rad_s: float


class Gyro(Revertible):
    """Of one robot of a fleet that has them."""

    def __init__(self) -> None:
        self._value: float | None = None  # newest, whatever it is worth
        self._same_ns: int | None = None  # since when it is this one
        self._same = 0  # readings
        self._good_ns: int | None = None  # of the newest that could be used, or of the first telemetry
        self._wrong = ""  # with the newest reading

    def read(self, telemetry: Telemetry) -> Rate | None:
        """What one telemetry frame says; None: nothing that can be used."""
        rate, t_ns = telemetry.rate_rad_s, telemetry.t_ns
        if self._good_ns is None:
            self._good_ns = t_ns
        if rate is UNSET:
            self._value, self._wrong = None, "no reading; fit one, or write gyro = false"
            return None
        if rate != self._value or self._same_ns is None:
            self._value, self._same_ns, self._same = rate, t_ns, 0
        self._same += 1
        self._wrong = self._what_is_wrong(rate, t_ns - self._same_ns)
        if self._wrong:
            return None
        self._good_ns = t_ns
        return Rate(t_ns - LATE_NS, rate)

    def _what_is_wrong(self, rate_rad_s: float, same_for_ns: int) -> str:
        if abs(rate_rad_s) >= FULL_SCALE_RAD_S:
            return "at the end of its scale"
        if same_for_ns >= STUCK_NS and self._same >= STUCK_READINGS:
            return f"stuck at {math.degrees(rate_rad_s):.2f} deg/s"
        return ""

    def fault(self, now_ns: int) -> str | None:
        """What to tell people; None while it works, or telemetry has just begun."""
        if not self._wrong or self._good_ns is None or now_ns - self._good_ns < SILENT_NS:
            return None
        return f"gyro: {self._wrong}"
