"""Any experiment, from what was asked to its folder: run under a bar, result.json and figures written, tables shown."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from rich.console import Console, RenderableType

from agent.experiments.figure_files import Figures, write_figures
from agent.experiments.result import NAME, ExperimentResult, write_result
from agent.process.command import Failed, Progress, run_folder, with_bar

S = TypeVar("S")
R = TypeVar("R", bound=ExperimentResult)


def no_figures(result: ExperimentResult) -> Figures:
    """What an experiment has that draws nothing."""
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
    """Run it into `out` or runs/<UTC>; `counted` is what the bar counts.

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
