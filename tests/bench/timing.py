"""What several ways to do one thing take on this machine: processor time, in turn, in one process.

Medians of each, so that what else the machine does falls on all of them alike, and ratios of two ways, which another
machine has as well. A seed of a claim of costs is one repetition: it has one row, with a number for each way.
"""

from __future__ import annotations

import contextlib
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import cv2
import msgspec

from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked of a claim of costs."""

    times: int = 15  # that each way is taken


def claim_of_medians(
    run: Callable[[int, str, Any], list[Row]], figures: tuple[Figure, ...], explanation: str, **about: Any
) -> Claim:
    """A claim that runs alone, and whose figures are told by their keys; about: what else there is to a claim."""
    return Claim(run, partial(median_figures, figures), figures, explanation, alone=True, **about)


def claim_of_costs(
    run: Callable[[int, str, Settings], list[Row]], cases: Iterable[str], figures: tuple[Figure, ...], explanation: str
) -> Claim:
    """Of five repetitions, the least whose middle value has an interval of 90 %."""
    about = {"settings": Settings, "quick": {"times": 3}, "measured_on": "this machine", "seeds": 5}
    return claim_of_medians(run, figures, explanation, cases=tuple(cases), **about)


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


def median_figures(figures: Sequence[Figure], rows: Rows) -> dict[str, Value]:
    """A figure's key says what it tells: `case.way` the median of all rows, `case.way/other` that of how many times the
    other way it is, `case.way<=2` the share of rows in which it is no more. Left out: cases that were not run, and ways
    that this machine does not have."""
    found: dict[str, Value] = {}
    for figure in figures:
        case, _, told = figure.key.partition(".")
        told, _, most = told.partition("<=")
        way, _, other = told.partition("/")
        values = [row[way] / (row[other] if other else 1.0) for row in rows.get(case, ()) if way in row]
        if values:
            share = Share(sum(value <= float(most) for value in values), len(values)) if most else None
            found[figure.key] = share or Quantile(values, 50.0)
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
