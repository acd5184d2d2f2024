"""Rates and errors by water, image and focus, over all ranges."""

from __future__ import annotations

from rich.table import Table

from agent.experiments.detection.run import ERRORS, RANGES_M, Result


def table(result: Result) -> Table:
    """A line for each water, image and focus."""
    shown = Table(title=f"{result.sensor}, {result.places} places in each water, 0.25 to 1.5 m")
    for column in ("water", "image", "focus"):
        shown.add_column(column)
    for column in ("found", "false", "centre px", "95 %", "radius px", "95 %"):
        shown.add_column(column, justify="right")
    for case in result.cases:
        if tuple(case["range_m"]) != RANGES_M[-1]:
            continue
        shown.add_row(
            case["water"],
            case["image"],
            case["focus"],
            f"{case['found']}/{case['frames']}",
            f"{case['false']}/{case['pictures']}",
            *("-" if case[name] is None else f"{case[name]:.2f}" for name in ERRORS),
        )
    return shown
