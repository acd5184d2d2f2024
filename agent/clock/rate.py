"""How fast run time is tried to go: as asked for, less where the machine does not keep up, more again when it does."""

from __future__ import annotations

WINDOW_NS = 250_000_000  # of the wall, over which the rate is measured
HEADROOM = 1.4  # above what was achieved: who is waited for shows, and the rate grows back this fast a window
LOWEST = 0.1  # tried, however slow the machine
STANDING_NS = 1_000_000_000  # a longer gap says that we were stopped ourselves, and nothing of the machine's speed
UNATTENDED = 1.0  # while agents are still to come nothing is gained by hurrying past them
TOLD = 4  # windows that a person is told of as one: what the rate was over a second


class Rate:
    """Fed with each step of the clock."""

    def __init__(self, speed: float, now_ns: int, wall_ns: int) -> None:
        """At most `speed` seconds of run time in one of the wall."""
        self.achieved = min(speed, UNATTENDED)  # over the last window
        self.told: list[float] = []  # over each second in which everybody took part
        self.wall_s = 0.0  # since the start, gaps not counted
        self._speed, self._tried = speed, min(speed, UNATTENDED)
        self._began = self._newest = (now_ns, wall_ns)
        self._complete = False
        self._windows: list[tuple[int, int]] = []  # run time and wall time of each, for the next to be told

    def step(self, now_ns: int, wall_ns: int, complete: bool) -> float:
        """It is now_ns; `complete`: everybody takes part. Returns the rate to try next."""
        gap_ns = wall_ns - self._newest[1]
        self._newest = now_ns, wall_ns
        if gap_ns > STANDING_NS or complete != self._complete:
            self._complete, self._began = complete, self._newest
            self._windows.clear()
            self._tried = min(self._tried, self._allowed())
            return self._tried
        self.wall_s += gap_ns * 1e-9
        run_ns, took_ns = now_ns - self._began[0], wall_ns - self._began[1]
        if took_ns >= WINDOW_NS:
            self.achieved = run_ns / took_ns
            self._tried = min(max(HEADROOM * self.achieved, LOWEST), self._allowed())
            self._began = self._newest
            if complete:
                self._tell(run_ns, took_ns)
        return self._tried

    def _allowed(self) -> float:
        return self._speed if self._complete else min(self._speed, UNATTENDED)

    def _tell(self, run_ns: int, took_ns: int) -> None:
        self._windows.append((run_ns, took_ns))
        if len(self._windows) == TOLD:
            runs, walls = zip(*self._windows, strict=True)
            self.told.append(sum(runs) / sum(walls))
            self._windows.clear()
