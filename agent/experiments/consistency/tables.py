"""Normalised errors by range and cue, and why there was no measurement."""

from __future__ import annotations

from collections import Counter

from rich.console import Group
from rich.table import Table

from agent.experiments.consistency.run import ENOUGH, Result
from agent.experiments.result import Row


def table(result: Result) -> Group:
    """Cases, refusals, and whether the mean is where it should be."""
    reasons = refusals(result.measurements).most_common()
    low, high = result.expected
    return Group(
        cases_table(result.cases),
        *(f"no measurement, {times} times: {reason}" for reason, times in reasons),
        *([f"missed: the mean with both cues is not within {low:g} to {high:g}"] if result.failed else []),
        *([f"no verdict: the target is for {ENOUGH} measurements"] if result.honest is None else []),
    )


def refusals(measurements: list[Row]) -> Counter[str]:
    """Why there was no measurement, numbers left out so that like counts with like."""
    reasons = (one["both"]["refused"] for one in measurements if "refused" in one["both"])
    return Counter("".join("#" if c.isdigit() else c for c in reason) for reason in reasons)


def cases_table(cases: list[Row]) -> Table:
    """A line for each of the cues and each band of range."""
    shown = Table(title="normalised error squared: 3 is honest, more is boastful, less is timid")
    for column in ("cues", "range m", "measured", "mean", "median (2.37)", "rms error mm", "stated sigma mm"):
        shown.add_column(column, justify="left" if column == "cues" else "right")
    for case in cases:
        low, high = case["range_m"]
        figures = (case[key] for key in ("nees", "nees_median", "error_rms_mm", "sigma_mm"))
        shown.add_row(
            case["cues"],
            f"{low:g} to {high:g}",
            f"{case['measured']} of {case['count']}",
            *("-" if value is None else f"{value:.2f}" for value in figures),
        )
    return shown
