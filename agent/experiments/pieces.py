"""Many draws of many cases on all processors, with one progress bar."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from typing import Any, NamedTuple

from agent.process.command import Progress


class Task(NamedTuple):
    """Draws of one case."""

    draw: Callable[[int, int], list[Any]]  # from the first to the last, the latter excluded; goes to other processes
    draws: int
    cost: int  # of one draw, in any unit
    unit: int  # draws in one piece of work


def all_draws(tasks: Sequence[Task], progress: Progress) -> list[list[Any]]:
    """The draws of each task, in order. Progress counts them by their cost."""
    work = [(n, first) for n, task in enumerate(tasks) for first in range(0, task.draws, task.unit)]
    work.sort(
        key=lambda item: -tasks[item[0]].cost * tasks[item[0]].unit
    )  # the longest first, so that all end together
    found: list[dict[int, list[Any]]] = [{} for _ in tasks]
    total, done = sum(task.draws * task.cost for task in tasks), 0
    progress(done, total)
    processes = multiprocessing.get_context("spawn")  # a fork would copy the progress bar's thread in mid-step
    with ProcessPoolExecutor(os.cpu_count(), mp_context=processes) as pool:
        jobs = {}
        for n, first in work:
            last = min(first + tasks[n].unit, tasks[n].draws)
            jobs[pool.submit(tasks[n].draw, first, last)] = (n, first, last)
        for job in as_completed(jobs):
            n, first, last = jobs[job]
            found[n][first] = job.result()
            done += (last - first) * tasks[n].cost
            progress(done, total)
    return [[draw for first in sorted(parts) for draw in parts[first]] for parts in found]
