"""What was found in a folder of pictures, by colour and radius."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from agent.experiments.detection.picture_run import FOUND_SHARE, JUDGED_PX, RADIUS_ERROR, Result
from agent.experiments.result import Row


def table(result: Result) -> Group:
    """A line for each colour and stretch of radius, what was false, and which targets are missed."""
    shown = Table(title=f"{result.folder}: {result.pictures} pictures, each searched for every colour")
    for column in ("ball", "radius px", "found", "radius error, median"):
        shown.add_column(column, justify="left" if column == "ball" else "right")
    for row in result.by_radius:
        shown.add_row(row["colour"], _stretch(row), f"{row['found']}/{row['marked']}", _percent(row))
    lines = [f"called a ball and none: {result.false} in {result.pictures} pictures"]
    if result.within_sigma is not None:
        shares = " / ".join(f"{100 * share:.0f} %" for share in result.within_sigma)
        lines.append(f"radius within 1 / 2 / 3 of its stated sigma: {shares}")
    lines += [f"missed: {text}" for text in result.missed] or [f"targets kept: {_kept(result)}"]
    return Group(shown, *lines)


def _kept(result: Result) -> str:
    """What a folder has shown: of balls nothing where none is marked that large."""
    if not any(row["radius_px"][0] >= JUDGED_PX for row in result.by_radius):
        return f"none false; no ball from {JUDGED_PX:g} px radius on is marked, so nothing is said of found ones"
    found, radius = f"found {100 * FOUND_SHARE:.0f} %", f"radius within {100 * RADIUS_ERROR:.0f} %"
    return f"{found} from {JUDGED_PX:g} px on, {radius}, none false"


def _stretch(row: Row) -> str:
    low, high = row["radius_px"]
    return f"{low:g} and more" if high is None else f"{low:g} to {high:g}"


def _percent(row: Row) -> str:
    return "-" if row["radius_error_median"] is None else f"{100 * row['radius_error_median']:.1f} %"
