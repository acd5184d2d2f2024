"""What all experiments share: result.json, figures, the run itself, draws on all processors, statistics, choices."""

from __future__ import annotations

import json
import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, TypeVar, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console, RenderableType

from agent.core.config import WaterKind
from agent.process.command import Failed, Progress, run_folder, with_bar

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# --- result.json ---

NAME = "result.json"
BESIDE = "shown"  # the one field that stays out of the file

Row = dict[str, Any]  # of a list in result.json


class ExperimentResult(msgspec.Struct, frozen=True, kw_only=True):
    """Base of all results: fields are the keys of result.json in their order, units in the names.

    A field `shown` holds what tables and figures need beyond that.
    """

    def as_json(self) -> dict[str, Any]:
        """The content of result.json."""
        return {name: getattr(self, name) for name in self.__struct_fields__ if name != BESIDE}

    @property
    def failed(self) -> bool:
        """Whether a target is missed, which is exit code 1. An experiment that has no targets misses none, nor does one
        that was run too seldom to tell: it gives no verdict."""
        return False


def write_result(result: ExperimentResult, folder: Path) -> None:
    """Write result.json."""
    (folder / NAME).write_text(json.dumps(result.as_json(), indent=1) + "\n", encoding="utf-8")


# --- figures ---

Figures = Iterator[tuple[str, "Figure"]]  # file name and figure; the name's suffix says how it is written


def write_figures(figures: Figures, folder: Path) -> None:
    """Write them all into `folder`; in SVG text stays text, and neither a date nor drawn ids make two runs differ."""
    import matplotlib  # here, for the command line reads this file for its names alone

    for name, figure in figures:
        with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
            figure.savefig(folder / name, metadata={"Date": None} if name.endswith(".svg") else None)


# --- one run, from its settings to its folder ---

S = TypeVar("S")
R = TypeVar("R", bound=ExperimentResult)


def no_figures(result: ExperimentResult) -> Figures:
    """The figures of an experiment that draws none."""
    return iter(())


def perform(
    run: Callable[[S, Progress], R],
    settings: S,
    table: Callable[[R], RenderableType],
    out: Path | None,
    console: Console,
    counted: str,
    figures: Callable[[R], Figures] = no_figures,
) -> R:
    """Run it into `out` or runs/<UTC>: progress bar, result.json, figures, tables. `counted` is what the bar counts.

    Raises ConfigError where the folder holds anything or cannot be written, whatever the run raises, and at its end
    Failed where the experiment misses a target.
    """
    folder = run_folder(out)
    result = with_bar(console, counted, lambda show: run(settings, show))
    write_result(result, folder)
    write_figures(figures(result), folder)
    console.print(table(result))
    console.print(f"written to {folder}")
    if result.failed:
        raise Failed(f"a target is missed; the tables say which, and {folder / NAME}")
    return result


# --- many draws of many cases on all processors ---


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


# --- statistics of cases, of which some never come to an end ---


def spread(times_s: Sequence[float | None]) -> dict[str, float | int | None]:
    """Median, 95th percentile (the smallest time that at least 95 % of the cases keep) and how many never did.

    A median is None where half of the cases never did, a percentile likewise.
    """
    ordered = np.sort([math.inf if t is None else t for t in times_s])

    def finite(value: float) -> float | None:
        return value if math.isfinite(value) else None

    n = len(ordered)
    middle = 0.5 * (float(ordered[(n - 1) // 2]) + float(ordered[n // 2]))
    return {
        "median": finite(middle),
        "p95": finite(float(ordered[-(-95 * n // 100) - 1])),
        "never": sum(t is None for t in times_s),
    }


def rms(values: NDArray[np.floating[Any]] | Sequence[float]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def number_or_never(value: float | None) -> str:
    """A figure as tables show it."""
    return "never" if value is None else f"{value:.2f}"


# --- choices of the command line ---
# The names that an experiment can be asked for.

Sensor = Literal["imx519_640", "binned_640", "crop_1280"]  # the presets of hw.twin.optics.lens
LocalizationKind = Literal["accuracy", "liar"]
NavigationCase = Literal["fix", "hold", "goto", "turn", "orbit", "separation", "target", "aid", "follow", "search"]
PosesKind = Literal["exact", "noisy", "refined"]  # of cameras that a scene is reconstructed from
ScenePart = Literal["scenes", "coverage", "swimmers", "size"]  # of the experiment reconstruction
ModelKind = Literal["surfels", "field"]  # what a scene's pictures are rendered by
FollowingPolicy = Literal["share", "silent", "moored"]
LightWater = Literal["coastal", "bay", "harbour"]  # dark waters of which absorption and scattering are told apart
DEFAULT_SENSOR: Sensor = "imx519_640"
WATERS: tuple[WaterKind, ...] = get_args(WaterKind)
