"""The machine's own clocks and waits, and its memory: for what belongs to the machine and not to a dive.

How long a disk took, a process has to end, a measurement of speed lasted. The only file that imports `time`.
"""

from __future__ import annotations

import ctypes
import time
from functools import cache
from threading import Condition, Event

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of glibc's mallopt
KEPT_BYTES = 1 << 30


def monotonic_ns() -> int:
    """CLOCK_MONOTONIC, which all processes of one machine share."""
    return time.monotonic_ns()


def monotonic_s() -> float:
    return time.monotonic()


def since_boot_s() -> float:
    """Time that goes on while the computer sleeps, where the system has such a clock."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


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


@cache
def keep_memory() -> None:
    """What one array frees, the next one gets. Else glibc hands large ones back to the system, which clears all their
    pages anew: a third of the time of a drawn frame, half of that of LU2Net as it is trained."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(M_MMAP_THRESHOLD, KEPT_BYTES)
        mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)
