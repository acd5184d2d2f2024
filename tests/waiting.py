"""Waiting for what other processes and threads do: for a condition, never for a time."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PAUSE_S = 0.02


def until(condition: Callable[[], T], timeout_s: float = 60.0, what: Callable[[], object] = lambda: "in vain") -> T:
    """Ask again and again; returns the first answer that is true. AssertionError with what() after `timeout_s`
    of the wall, generous: a machine may be busy."""
    deadline_s = time.monotonic() + timeout_s
    while not (answer := condition()):
        assert time.monotonic() < deadline_s, f"waited {timeout_s:.0f} s: {what()}"
        time.sleep(PAUSE_S)
    return answer
