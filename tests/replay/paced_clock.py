"""A clock of a dive as tests want it: it goes on when told, so many times as fast as its wall."""

from agent.clock.clock import StandingClock


class PacedClock(StandingClock):
    """Both clocks are its own: run time, and the Unix time of the wall."""

    def __init__(self, start_ns: int, rate: float) -> None:
        super().__init__(start_ns)
        self.start_ns = self._now_ns = start_ns
        self.started_unix_ns = self._unix_ns = start_ns - 10**12
        self._rate = rate

    def now_ns(self) -> int:
        return self._now_ns

    def unix_ns(self) -> int:
        return self._unix_ns

    def rate(self) -> float:
        return self._rate

    def change_rate(self, rate: float) -> None:
        self._rate = rate

    def go_on(self, seconds: float) -> None:
        """By so much of run time."""
        self._now_ns += round(seconds * 1e9)
        self._unix_ns += round(seconds / self._rate * 1e9)
