"""How fast run time is tried to go: as asked for, less where the machine does not keep up, more again when it does."""

from __future__ import annotations

WINDOW_NS = 250_000_000  # of the wall, over which the rate is measured
HEADROOM = 1.4  # above what was achieved: who is waited for shows, and the rate grows back this fast a window
LOWEST = 0.1  # tried, however slow the machine
STANDING_NS = 1_000_000_000  # a longer gap says that we were stopped ourselves, and nothing of the machine's speed
UNATTENDED = 1.0  # while agents are still to come nothing is gained by hurrying past them


class Rate:
    """Fed with each step of the clock."""

    def __init__(self, speed: float, now_ns: int, wall_ns: int) -> None:
        self.achieved = self.slowest = self.fastest = min(speed, UNATTENDED)
        self.wall_s = 0.0  # since the start, gaps not counted
        self._speed, self._tried = speed, min(speed, UNATTENDED)
        self._from = self._newest = (now_ns, wall_ns)
        self._complete = False
        self._measured = False

    def step(self, now_ns: int, wall_ns: int, complete: bool) -> float:
        """It is now_ns; `complete`: everybody takes part. Returns the rate to try next."""
        before_ns = self._newest[1]
        self._newest = now_ns, wall_ns
        if wall_ns - before_ns > STANDING_NS or complete != self._complete:
            self._complete, self._from = complete, self._newest
            self._tried = min(self._tried, self._fastest_allowed())
            return self._tried
        self.wall_s += (wall_ns - before_ns) * 1e-9
        began_ns, began_wall_ns = self._from
        if wall_ns - began_wall_ns >= WINDOW_NS:
            self.achieved = (now_ns - began_ns) / (wall_ns - began_wall_ns)
            self._tried = min(max(HEADROOM * self.achieved, LOWEST), self._fastest_allowed())
            self._from = self._newest
            if complete:
                self._remember()
        return self._tried

    def _fastest_allowed(self) -> float:
        return self._speed if self._complete else min(self._speed, UNATTENDED)

    def _remember(self) -> None:
        if not self._measured:
            self._measured, self.slowest, self.fastest = True, self.achieved, self.achieved
        self.slowest, self.fastest = min(self.slowest, self.achieved), max(self.fastest, self.achieved)
