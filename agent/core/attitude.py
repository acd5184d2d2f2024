"""Depth, roll and pitch at a given time, from the telemetry of the last seconds."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from msgspec import UNSET

from agent.core.step_io import Telemetry
from agent.core.step_transaction import Revertible

KEEP_NS = 6_000_000_000  # longer than a full sweep: the sharpest frame may be its first
FRESH_NS = 500_000_000  # 25 missed frames: the module is silent


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
        self.status: Telemetry | None = None  # the newest that has what comes once a second

    @property
    def newest(self) -> Telemetry | None:
        return self._log[-1] if self._log else None

    def add(self, telemetry: Telemetry) -> None:
        self._log.append(telemetry)
        if telemetry.heap_free_b is not UNSET:
            self.status = telemetry
        while self._log[0].t_ns < telemetry.t_ns - self._keep_ns:
            self._log.popleft()

    def extend(self, told: Iterable[Telemetry]) -> None:
        for telemetry in told:
            self.add(telemetry)

    def silent(self, now_ns: int, since_ns: int) -> bool:
        """Whether no telemetry came of late; `since_ns` is when listening began."""
        newest_ns = self._log[-1].t_ns if self._log else since_ns
        return now_ns - newest_ns > FRESH_NS

    def obeys(self, now_ns: int) -> bool:
        """Whether forces act: the module is armed and not in failsafe.

        It refuses to arm while it is asked for forces, and none act while it has taken over.
        """
        newest = self.newest
        return newest is not None and not self.silent(now_ns, 0) and newest.armed and newest.ladder == 0

    def now(self, now_ns: int) -> Attitude | None:
        """By the newest telemetry; None: the module is silent."""
        newest = self.newest
        return None if newest is None or self.silent(now_ns, 0) else self.at(newest.t_ns)

    def at(self, t_ns: int) -> Attitude | None:
        """Linear between the two frames around a time; None where there are none near."""
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
