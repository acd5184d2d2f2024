"""Whole dives beside busy processes and at other speeds: the clock of a dive waits, and nothing in it comes late."""

from __future__ import annotations

import math
import sys
from contextlib import ExitStack
from io import StringIO
from subprocess import Popen
from typing import NamedTuple

from rich.console import Console

from agent.demo.demo import demo
from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Share, Value
from agent.experiments.demo import times_real_time
from agent.process.command import temporary_folder
from tests.bench.timing import median_figures
from tests.dive_timing import nothing_came_late, timing
from tests.killing import killed_after


class Case(NamedTuple):
    words: str
    speed: float
    busy: int = 0  # processes that want a whole core each


CASES = {
    "busy": Case("as fast as can be, beside two busy processes", math.inf, 2),
    "busy-at-1": Case("at real time, beside two busy processes", 1.0, 2),
    "at-1": Case("at real time", 1.0),
    "slow": Case("at a quarter of real time", 0.25),
}


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """One dive of three robots. Raises Failed where one of its processes fails."""
    speed, busy = CASES[case].speed, CASES[case].busy
    with temporary_folder() as folder, ExitStack() as stack:
        others = {str(k): Popen([sys.executable, "-c", "while True: pass"]) for k in range(busy)}
        stack.enter_context(killed_after(others))
        out, summary = demo(None, None, None, seed, 120.0, folder / "run", Console(file=StringIO()), speed=speed)
        log, boxes = out / "logs" / "twin.log", [out / f"{robot}.mcap" for robot in summary["agents"]]
        try:
            nothing_came_late(log.read_text(encoding="utf-8"), *boxes)
            in_time = True
        except AssertionError:
            in_time = False
        step_ms = 1e3 * max(timing(box).step_gap_s for box in boxes)
        return [{"in_time": in_time, "speed": times_real_time(log), "step_ms": step_ms}]


def summary(rows: Rows) -> dict[str, Value]:
    in_time = {
        f"{case}.in_time": Share(sum(dive["in_time"] for dive in dives), len(dives)) for case, dives in rows.items()
    }
    return median_figures(CLAIM.figures, rows) | in_time


CLAIM = Claim(
    run=run,
    summary=summary,
    cases=tuple(CASES),
    by_default=("busy",),
    measured_on="processes",
    figures=tuple(
        figure
        for name, case in CASES.items()
        for figure in (
            Figure(f"{name}.in_time", f"dives in which nothing came late, {case.words}", "%", least=95.0),
            Figure(f"{name}.step_ms", "latest step of a robot after the one before, 50 by design", "ms"),
            Figure(f"{name}.speed", "a dive's speed", "times real time"),
        )
    ),
    seeds=60,  # as many as the 95 % take
    alone=True,
    explanation="""Dives of three robots in the twin, as `aucamp demo` has them. Late is a step of a robot's loop more
        than 80 ms after the one before, in the dive's own time, or anything of which the twin complains. Steps and
        speeds are medians of dives.""",
)
