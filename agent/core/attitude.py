"""Depth, roll and pitch at a given time, from the telemetry of the last seconds."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from msgspec import UNSET

from agent.core.config import CAREFUL, Budget
from agent.core.step_io import Telemetry
from agent.core.step_transaction import Revertible

KEEP_NS = 6_000_000_000  # longer than a full sweep: the sharpest frame may be its first
FRESH_NS = 500_000_000  # 25 missed frames: the module is silent
LATE_NS = 20_000_000  # telemetry comes so long after what it tells of: by the board's filter, and the way

SENSORS_APART_M = 0.26  # from left to right and from front to back
WARM_S = 600.0  # time constant by which they warm up
# The noise of the sensors in the attitude at an exposure, between two frames of telemetry: on the twin 0.065 to 0.09
# degrees in roll and in pitch, and 0.24 mm.
LEVEL_NOISE_RAD, DEPTH_NOISE_M = math.radians(0.08), 0.00024


class Attitude(NamedTuple):
    """Of the body at one time."""

    depth_m: float
    roll_deg: float
    pitch_deg: float


class AttitudeLog(Revertible):
    """Telemetry in order of arrival."""

    def __init__(self, keep_ns: int = KEEP_NS) -> None:
        """keep_ns: how long telemetry is kept."""
        self._keep_ns = keep_ns
        self._log: deque[Telemetry] = deque()
        self._on_ns: int | None = None  # the earliest time that the module's clock may have begun at
        self.status: Telemetry | None = None  # the newest that has what comes once a second

    @property
    def newest(self) -> Telemetry | None:
        return self._log[-1] if self._log else None

    def add(self, telemetry: Telemetry) -> None:
        self._log.append(telemetry)
        began_ns = telemetry.t_ns - 1000 * telemetry.board_us
        # It wraps after 71 minutes, and begins anew where the module does, whose sensors may stay warm.
        self._on_ns = began_ns if self._on_ns is None else min(self._on_ns, began_ns)
        if telemetry.heap_free_b is not UNSET:
            self.status = telemetry
        while self._log[0].t_ns < telemetry.t_ns - self._keep_ns:
            self._log.popleft()

    def extend(self, told: Iterable[Telemetry]) -> None:
        for telemetry in told:
            self.add(telemetry)

    def on_s(self, t_ns: int) -> float:
        """How long the control module had been on by then."""
        return 0.0 if self._on_ns is None else max(t_ns - self._on_ns, 0) * 1e-9

    def silent(self, now_ns: int, since_ns: int) -> bool:
        """Whether no telemetry came of late; `since_ns` is when listening began."""
        newest_ns = self._log[-1].t_ns if self._log else since_ns
        return now_ns - newest_ns > FRESH_NS

    def heard(self, now_ns: int) -> Telemetry | None:
        """The newest telemetry; None: the module is silent."""
        return None if self.silent(now_ns, 0) else self.newest

    def obeys(self, now_ns: int) -> bool:
        """Whether forces act: the module is armed and not in failsafe.

        It refuses to arm while it is asked for forces, and none act while it has taken over.
        """
        newest = self.heard(now_ns)
        return newest is not None and newest.armed and newest.ladder == 0

    def now(self, now_ns: int) -> Attitude | None:
        """By the newest telemetry; None: the module is silent."""
        newest = self.heard(now_ns)
        return None if newest is None else self.at(newest.t_ns - LATE_NS)

    def at(self, t_ns: int) -> Attitude | None:
        """Linear between the two frames that tell of about that time; None where there are none near."""
        t_ns += LATE_NS
        before = after = None
        for telemetry in reversed(self._log):  # the time asked about is a moment ago
            if telemetry.t_ns <= t_ns:
                before = telemetry
                break
            after = telemetry
        if before is None or t_ns - before.t_ns > FRESH_NS:
            return None
        if after is None or after.t_ns - before.t_ns > FRESH_NS:
            return Attitude(before.depth_m, before.roll_deg, before.pitch_deg)
        share = (t_ns - before.t_ns) / (after.t_ns - before.t_ns)
        return Attitude(
            before.depth_m + share * (after.depth_m - before.depth_m),
            before.roll_deg + share * (after.roll_deg - before.roll_deg),
            before.pitch_deg + share * (after.pitch_deg - before.pitch_deg),
        )


class Zeros(NamedTuple):
    """What the zeros of the pressure sensors make wrong of height and of roll and pitch, as standard deviations."""

    height_m: float
    tilt_rad: float
    height_m_s: float  # of how fast that changes
    tilt_rad_s: float


def zeros(budget: Budget, on_s: float) -> Zeros:
    """Of a module that has been on for so long.

    The zeros of its four sensors, found cold, wander by budget.drift_m each, by itself: depth is their mean, roll and
    pitch are differences of two means over SENSORS_APART_M.
    """
    cold = math.exp(-on_s / WARM_S)
    drift_m, drift_m_s = budget.drift_m * (1.0 - cold), budget.drift_m * cold / WARM_S
    return Zeros(
        math.hypot(budget.height_m, 0.5 * drift_m),
        math.hypot(math.radians(budget.attitude_deg), drift_m / SENSORS_APART_M),
        0.5 * drift_m_s,
        drift_m_s / SENSORS_APART_M,
    )


TARED = zeros(CAREFUL, 0.0)
