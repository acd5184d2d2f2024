"""The machine's own clocks and waits: for what belongs to the machine and not to a dive.

How long a disk took, a process has to end, a measurement of speed lasted. The only file that imports `time`.
"""

from __future__ import annotations

import time
from threading import Condition, Event


def monotonic_ns() -> int:
    """CLOCK_MONOTONIC, which all processes of one machine share."""
    return time.monotonic_ns()


def monotonic_s() -> float:
    return time.monotonic()


def unix_ns() -> int:
    """Time of day; it may step."""
    return time.time_ns()


def stopwatch_s() -> float:
    """The finest clock there is, for durations."""
    return time.perf_counter()


def sleep(seconds: float) -> None:
    time.sleep(seconds)


def wait(event: Event, seconds: float) -> bool:
    """Whether the event was set within so many seconds of the wall."""
    return event.wait(seconds)


def wait_changed(condition: Condition, seconds: float) -> None:
    """Return when the condition, held by the caller, is notified, or after so many seconds of the wall."""
    condition.wait(seconds)
