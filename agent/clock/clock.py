"""A clock as everybody holds it, and the system's own, by which robots with real devices live."""

from __future__ import annotations

from threading import Condition, Event
from typing import Protocol

from agent.clock import machine

REST_NS = 1 << 62  # "wake me for news only": later than anything


class Clock(Protocol):
    """Unix time in nanoseconds that never steps back. It may run faster or slower than the wall, or stand."""

    camera_offset_ns: int  # from the stamps of cameras that live by this clock to its own time

    @property
    def start_ns(self) -> int | None:
        """When the dive began, in its own time; None: there is no twin."""

    def now_ns(self) -> int: ...

    def wall_s(self, until_ns: int) -> float:
        """How long to sleep on the wall before looking again whether it is `until_ns`; 0: it is."""

    def rate(self) -> float:
        """Seconds of this clock in a second of the wall, of late."""

    def is_driven(self) -> bool:
        """Whether the twin whose time it is lives; of the system's clock always."""

    def join(self, part: str, slack_ns: int) -> None:
        """From now on this clock waits for a part of this process: it goes no further than slack_ns beyond what
        the part has reached."""

    def reach(self, part: str, until_ns: int) -> None:
        """The part has done everything that is due before until_ns."""

    def leave(self, part: str) -> None:
        """It is not waited for any more."""


class SystemClock:
    """Sampled once, then monotonic: an adjustment of the time of day is no event of a dive. It waits for nobody."""

    start_ns: int | None = None

    def __init__(self) -> None:
        self.camera_offset_ns = machine.unix_ns() - machine.monotonic_ns()

    def now_ns(self) -> int:
        return self.camera_offset_ns + machine.monotonic_ns()

    def wall_s(self, until_ns: int) -> float:
        return max(0.0, (until_ns - self.now_ns()) * 1e-9)

    def rate(self) -> float:
        return 1.0

    def is_driven(self) -> bool:
        return True

    def join(self, part: str, slack_ns: int) -> None:
        pass

    def reach(self, part: str, until_ns: int) -> None:
        pass

    def leave(self, part: str) -> None:
        pass


class StandingClock(SystemClock):
    """It is always the same time, and stamps are told as they are: for frames of a recording."""

    def __init__(self, at_ns: int = 0) -> None:
        self.camera_offset_ns, self._at_ns = 0, at_ns

    def now_ns(self) -> int:
        return self._at_ns


def wait(clock: Clock, event: Event, seconds: float) -> bool:
    """Whether the event was set within so many seconds of the clock."""
    return wait_until(clock, event, clock.now_ns() + round(seconds * 1e9))


def wait_until(clock: Clock, event: Event, until_ns: int) -> bool:
    """Whether the event was set before it was until_ns."""
    while (left_s := clock.wall_s(until_ns)) > 0.0:
        if event.wait(left_s):
            return True
    return event.is_set()


class Part:
    """One thread that a clock waits for, such as an agent's loop; used by that thread, except for `resume`.

    It holds the clock back while it works, never while it waits.
    """

    def __init__(self, clock: Clock, name: str, slack_s: float) -> None:
        self._clock, self._name = clock, name
        clock.join(name, round(slack_s * 1e9))

    def wait(self, event: Event, until_ns: int) -> None:
        """Return when it is until_ns, or the event is set."""
        self._clock.reach(self._name, until_ns)
        wait_until(self._clock, event, until_ns)

    def wait_changed(self, condition: Condition, until_ns: int) -> bool:
        """Return when the condition, held by the caller, may have been notified (True), or it is until_ns (False)."""
        self._clock.reach(self._name, until_ns)
        left_s = self._clock.wall_s(until_ns)
        if left_s > 0.0:
            condition.wait(left_s)
        return left_s > 0.0

    def resume(self) -> None:
        """Work has come, or is about to: called by who brings it, before the thread that waits knows of it."""
        self._clock.reach(self._name, self._clock.now_ns())

    def rest(self) -> None:
        """Nothing to do until news comes."""
        self._clock.reach(self._name, REST_NS)

    def leave(self) -> None:
        """The thread ends."""
        self._clock.leave(self._name)
