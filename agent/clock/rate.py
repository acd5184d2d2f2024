"""How fast run time may go, how fast it went, and how fast it will go next: followers sleep by that until they look
again, so it should be a little above what is true."""

from __future__ import annotations

from collections import deque

WINDOW_NS = 100_000_000  # of the wall, over which the rate is measured
HEADROOM = 2.0  # above what was achieved: who sleeps too long holds everybody up
LOWEST = 0.5  # expected, however slow the machine was just now
STANDING_NS = 1_000_000_000  # a longer gap says that we were stopped ourselves, and nothing of the machine's speed
UNATTENDED = 1.0  # nothing is gained by hurrying past agents that are still to come, or compile
SECOND = 10  # windows: a person is told of no shorter time


class Rate:
    """Fed with each step of the clock."""

    def __init__(self, speed: float, now_ns: int, wall_ns: int) -> None:
        """At most `speed` seconds of run time in one of the wall."""
        self.achieved = min(speed, UNATTENDED)  # over the last second
        self.told: list[float] = []  # over each second in which everybody took part
        self.wall_s = 0.0  # since the start, gaps not counted
        self._speed, self._expected = speed, min(speed, UNATTENDED)
        self._began = self._newest = (now_ns, wall_ns)
        self._complete = False
        self._windows: deque[tuple[int, int]] = deque(maxlen=SECOND)  # run time and wall time of each
        self._untold = 0

    def step(self, now_ns: int, wall_ns: int, complete: bool) -> float:
        """It is now_ns; `complete`: everybody takes part. Returns the rate to expect next."""
        gap_ns = wall_ns - self._newest[1]
        self._newest = now_ns, wall_ns
        if gap_ns > STANDING_NS or complete != self._complete:
            self._complete, self._began = complete, self._newest
            self._untold = 0
            self._expected = min(self._expected, self.allowed)
            return self._expected
        self.wall_s += gap_ns * 1e-9
        run_ns, took_ns = now_ns - self._began[0], wall_ns - self._began[1]
        if took_ns >= WINDOW_NS:
            self._expected = min(max(HEADROOM * run_ns / took_ns, LOWEST), self.allowed)
            self._began = self._newest
            self._measured(run_ns, took_ns)
        return self._expected

    @property
    def allowed(self) -> float:
        """Not the machine, but what was asked for."""
        return self._speed if self._complete else min(self._speed, UNATTENDED)

    def _measured(self, run_ns: int, took_ns: int) -> None:
        self._windows.append((run_ns, took_ns))
        runs, walls = zip(*self._windows, strict=True)
        self.achieved = sum(runs) / sum(walls)
        self._untold += 1
        if self._untold == SECOND:
            self._untold = 0
            if self._complete:
                self.told.append(self.achieved)
