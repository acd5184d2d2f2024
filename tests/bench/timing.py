"""What several ways to do one thing take on this machine: processor time, in turn, in one process.

Medians of each, so that what else the machine does falls on all of them alike, and ratios of two ways, which another
machine has as well. A seed of a claim of costs is one repetition: it has one row, with a number for each way.
"""

from __future__ import annotations

import contextlib
import statistics
import time
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

import cv2
import msgspec

from agent.experiments.claim import Quantile, Rows, Value


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked of a claim of costs."""

    times: int = 15  # that each way is taken


QUICK = {"times": 3}
REPETITIONS = 5  # seeds: the least whose middle value has an interval of 90 %


class Told(NamedTuple):
    """What a figure tells of a row: a value, or how many times another one it is."""

    case: str
    way: str
    against: str = ""


def medians_ms(
    ways: Mapping[str, Callable[[], object]], times: int, clock: Callable[[], float] = time.thread_time
) -> dict[str, float]:
    """Of the processor time of this thread; `clock`: time.process_time, where a way has threads of its own."""
    taken_ms: dict[str, list[float]] = {way: [] for way in ways}
    for work in ways.values():
        work()  # caches and compilers are warm
    for _ in range(times):
        for way, work in ways.items():
            began_s = clock()
            work()
            taken_ms[way].append(1e3 * (clock() - began_s))
    return {way: statistics.median(taken) for way, taken in taken_ms.items()}


def median_figures(rows: Rows, figures: Mapping[str, Told]) -> dict[str, Value]:
    """Medians over repetitions, of cases that were run and of ways that there are on this machine."""
    found: dict[str, Value] = {}
    for key, (case, way, against) in figures.items():
        values = [row[way] / (row[against] if against else 1.0) for row in rows.get(case, ()) if way in row]
        if values:
            found[key] = Quantile(values, 50.0)
    return found


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """OpenCV and torch keep to the calling thread."""
    from agent.perception.enhancement.enhance import one_thread as of_torch

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    of_torch()
    try:
        yield
    finally:
        cv2.setNumThreads(before)
