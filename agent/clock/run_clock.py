"""The clock of a dive in the twin, as everybody but the twin holds it.

Where no twin runs it is the system's clock. Where one starts, or starts again, it follows that one. Where one dies it
goes on from where it was, at the wall's pace: robots whose water has vanished still talk. It never steps back.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from threading import Lock

from agent.clock import machine, mapped
from agent.clock.clock import SystemClock
from agent.clock.mapped import ClockFile, Line

SHORTEST_S, LONGEST_S = 0.0005, 0.05  # sleeps between two looks at a clock that may change its rate, or stand
AGAIN_NS = 50_000_000  # of the wall, between two looks whether a twin has come or gone


class RunClock:
    """Threads of one process share it. See Clock for what the methods promise."""

    camera_offset_ns = 0  # the twin's cameras stamp with run time

    def __init__(self, path: Path) -> None:
        """`path`: where the twin writes its clock (hw.twin.devices.twin_folder.clock_path)."""
        self._path, self._system = path, SystemClock()
        self._file: ClockFile | None = None
        self._inode = -1
        self._driven = False
        self._looked_ns = -AGAIN_NS
        self._last_ns = 0
        self._parts: dict[str, int] = {}  # that we joined with, and their slack
        self._lock = Lock()  # while the file is exchanged, and for the last time told

    def now_ns(self) -> int:
        wall_ns = machine.monotonic_ns()
        line = self._line(wall_ns)
        if line is None:
            now_ns = self._system.now_ns()
        else:
            now_ns = line.at(wall_ns)
            if now_ns > line.horizon_ns:
                now_ns = line.horizon_ns if self._is_driven(wall_ns) else line.left_at(wall_ns)
        with self._lock:
            self._last_ns = now_ns = max(now_ns, self._last_ns)
        return now_ns

    def wall_s(self, until_ns: int) -> float:
        now_ns = self.now_ns()
        if now_ns >= until_ns:
            return 0.0
        wall_ns = machine.monotonic_ns()
        line = self._line(wall_ns)
        if line is None or not self._driven:
            return min((until_ns - now_ns) * 1e-9, LONGEST_S)
        standing_s = (line.at(wall_ns) - line.horizon_ns) * 1e-9 / line.rate
        if standing_s > 0.0:  # the longer it has stood, the longer it may
            return min(max(standing_s / 4.0, SHORTEST_S), LONGEST_S)
        return min(max((until_ns - now_ns) * 1e-9 / line.rate, SHORTEST_S), LONGEST_S)

    def rate(self) -> float:
        line = self._line(machine.monotonic_ns())
        return line.achieved if line is not None and self._driven else 1.0

    def is_driven(self) -> bool:
        return self._is_driven(machine.monotonic_ns(), again_ns=0)

    @property
    def start_ns(self) -> int | None:
        """When the dive began, in its own time; None: there is no twin."""
        return self._file.words[mapped.START] if self._file is not None else None

    def join(self, part: str, slack_ns: int) -> None:
        self.now_ns()  # looks for a twin
        with self._lock:
            self._parts[part] = slack_ns
            self._take_row(part, self._last_ns)

    def reach(self, part: str, until_ns: int) -> None:
        if self._file is not None and (index := self._file.rows.get(part)) is not None:
            self._file.reach(index, until_ns)

    def leave(self, part: str) -> None:
        with self._lock:
            self._parts.pop(part, None)
            if self._file is not None and (index := self._file.rows.get(part)) is not None:
                self._file.leave(index)

    def _take_row(self, part: str, reached_ns: int) -> None:
        if self._file is not None and (index := self._file.rows.get(part)) is not None:
            with contextlib.suppress(BlockingIOError):  # somebody else dives as this robot: its links will say so
                self._file.join(index, reached_ns, self._parts[part])

    def _line(self, wall_ns: int) -> Line | None:
        if self._file is None or not self._driven:
            self._is_driven(wall_ns)
        return self._file.line() if self._file is not None else None

    def _is_driven(self, wall_ns: int, again_ns: int = AGAIN_NS) -> bool:
        """Whether there is a living twin behind what we follow; looks for another one, but not all the time."""
        if wall_ns - self._looked_ns >= again_ns:
            with self._lock:
                self._looked_ns = wall_ns
                self._driven = self._file is not None and self._file.is_driven()
                if not self._driven:
                    self._follow_newest()
        return self._driven

    def _follow_newest(self) -> None:
        try:
            inode = self._path.stat().st_ino
        except OSError:
            return
        if inode == self._inode or (file := mapped.attach(self._path)) is None:
            return
        if not file.is_driven() and (self._file is not None or not self._is_ahead(file.line())):
            file.close()
            return
        self._file, self._inode = file, inode  # the old mapping stays: another thread may be reading it
        self._driven = file.is_driven()
        for part in self._parts:
            self._take_row(part, self._last_ns)

    def _is_ahead(self, line: Line) -> bool:
        """Whether a twin that died before we came, but not before the machine started, left time beyond the day's:
        those who outlived it must not think us of yesterday."""
        wall_ns = machine.monotonic_ns()
        return line.wall_ns <= wall_ns and line.left_at(wall_ns) > self._system.now_ns()
