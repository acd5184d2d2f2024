"""Recordings that are checked side by side, each in a process of its own: no robot's replay needs another's."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, wait
from functools import partial
from multiprocessing.sharedctypes import Synchronized
from typing import NamedTuple

from replay.check.black_box import BlackBox
from replay.check.compare import Ignored
from replay.check.links import Correspondence
from replay.check.reexecute import Reexecution, StepsDone, reexecute
from replay.files.suspect import suspecting

WORTH_STEPS = 1500  # of all recordings but the longest: less is done sooner than another process has started
SHOWN_S = 0.2  # between two looks at how far the others are

_done: Synchronized[int] | None = None  # in a process of the pool: steps, counted by all of them


class CheckedBox(NamedTuple):
    """What came of one recording, and who said what to whom in it."""

    result: Reexecution
    correspondence: Correspondence


def check_boxes(boxes: Sequence[BlackBox], rows: Sequence[Ignored], progress: StepsDone) -> list[CheckedBox]:
    """Each of the boxes, in order. Raises ConfigError for one that holds what no recorder writes."""
    spare = sum(box.recorded for box in boxes) - max((box.recorded for box in boxes), default=0)
    processes = min(len(boxes), os.cpu_count() or 1)
    if processes < 2 or spare < WORTH_STEPS:
        return [_check_box(box, rows, progress) for box in boxes]
    context = multiprocessing.get_context("spawn")  # a fork would copy the progress bar's thread in mid-step
    done: Synchronized[int] = context.Value("q", 0)
    with ProcessPoolExecutor(processes, context, _share, (done,)) as pool:
        longest_first = sorted(boxes, key=lambda box: -box.recorded)
        jobs = {box.path: pool.submit(_check_box, box, rows, _count) for box in longest_first}
        shown, due = 0, set(jobs.values())
        while due:
            due = wait(due, SHOWN_S).not_done
            now = done.value
            progress(now - shown)
            shown = now
        return [jobs[box.path].result() for box in boxes]


def _check_box(box: BlackBox, rows: Sequence[Ignored], progress: StepsDone) -> CheckedBox:
    correspondence = Correspondence()
    with suspecting(box.path):
        result = reexecute(box, rows, progress, partial(correspondence.add, box.robot))
    return CheckedBox(result, correspondence)


def _share(done: Synchronized[int]) -> None:
    """First of all in each process of the pool."""
    global _done
    _done = done


def _count(steps: int) -> None:
    assert _done is not None
    with _done.get_lock():
        _done.value += steps
