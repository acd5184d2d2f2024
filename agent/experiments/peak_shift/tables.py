"""Shifts of the peak by water and way to enhance."""

from __future__ import annotations

from rich.table import Table

from agent.experiments.peak_shift.run import Result

COLUMNS = {"mean_steps": "+.2f", "median_steps": ".2f", "p95_steps": ".2f", "median_mm": ".1f", "p95_mm": ".1f"}


def table(result: Result) -> Table:
    """A line for each water and way."""
    shown = Table(title=f"{result.sensor}, {result.views} views: shift of the focus peak, enhanced against raw")
    for column in ("water", "way"):
        shown.add_column(column)
    for column in ("blocks, raw", "enhanced", "mean steps", "median", "95 %", "median mm", "95 %"):
        shown.add_column(column, justify="right")
    for case in result.cases:
        cells = (format(case[name], how) if name in case else "-" for name, how in COLUMNS.items())
        shown.add_row(case["water"], case["way"], str(case["blocks_raw"]), str(case["blocks"]), *cells)
    return shown
