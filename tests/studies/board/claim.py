"""What a control cycle takes on an STM32F407: estimated from counted instructions, not timed."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import mean
from typing import Any

from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Value
from agent.process.command import Failed
from tests.studies.board import estimate
from tests.studies.board.boots import Options
from tests.studies.board.tools import FIRMWARE, BoardError, MissingTool


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """Raises Failed where a tool is missing, and for a firmware that cannot be measured."""
    options = Options(FIRMWARE)
    try:
        result = estimate.figures(estimate.measure(options), options)
    except (MissingTool, BoardError) as error:
        raise Failed(str(error)) from error
    if not result["armed"]:
        raise Failed("the firmware never armed: this measures the wrong thing")
    return [row(result)]


def row(result: Mapping[str, Any]) -> Row:
    """Of all figures those that have a target."""
    table = result["windows"]["armed"]["timetable"]
    return {
        "mean_ms": table["mean_ms"],
        "worst_ms": table["worst_ms"],
        "lost_percent": 100.0 * table["lost"],
        "bytes": mean(result["bytes_a_cycle"]),
        "free_kb": result["free_after_boot"] / 1000.0,
    }


def summary(rows: Rows) -> dict[str, Value]:
    return dict(rows["all"][0])


CLAIM = Claim(
    run=run,
    summary=summary,
    measured_on="chip model",
    figures=(
        Figure("mean_ms", "an armed cycle, mean", "ms", most=6.0),
        Figure("worst_ms", "an armed cycle, worst", "ms", most=9.0),
        Figure("lost_percent", "ticks of 10 ms that are lost", "% of ticks", most=0.0),
        Figure("bytes", "memory that a cycle takes, mean", "bytes", most=256.0),
        Figure("free_kb", "free heap after boot", "kB", least=50.0),
    ),
    exact=True,
    explanation="""The firmware runs on pretended hardware under MicroPython, and every instruction is counted. Prices
        make times of a Cortex-M4 of the counts; they are good to about 7 % for a whole cycle, and no chip is timed.
        What each function takes says `python -m tests.studies.board`.""",
)
