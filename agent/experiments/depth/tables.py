"""Errors of depth by sensor, peak and range; a ball's range by cue; what enhancement would do; what was missed."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from agent.experiments.depth.run import Result
from agent.experiments.result import Row


def table(result: Result) -> Group:
    """Two tables, and a line for each sensor and each target that was missed."""
    return Group(
        cases_table(result.cases),
        balls_table(result.balls),
        *map(enhanced_line, result.enhanced),
        *(f"missed: {text}" for text in result.missed),
    )


def cases_table(cases: list[Row]) -> Table:
    """A line for each sensor, way to take the peak, and range."""
    shown = Table(title="depth from focus against the twin's truth")
    for column in ("sensor", "peak", "range m", "mean error mm", "median mm", "accepted"):
        shown.add_column(column, justify="left" if column in ("sensor", "peak") else "right")
    for case in cases:
        low, high = case["range_m"]
        errors = (case["mae_mm"], case["median_mm"])
        shown.add_row(
            case["sensor"],
            case["peak"] + (", grid not growing" if case["grid"] == "fixed" else ""),
            f"{low:g} to {high:g}",
            *(f"{v:.1f}" if v is not None else "-" for v in errors),
            f"{100 * case['accepted']:.0f} %",
        )
    return shown


def balls_table(balls: list[Row]) -> Table:
    """A line for each sensor, distance and cue."""
    shown = Table(title="one ball, range from focus, from size, and from both")
    for column in ("sensor", "range m", "cues", "rms error mm", "stated sigma mm", "measured", "depth of field mm"):
        shown.add_column(column, justify="left" if column in ("sensor", "cues", "measured") else "right")
    for ball in balls:
        count, refused, field_m = len(ball["errors_mm"]), ball["refused"], ball["depth_of_field_m"]
        shown.add_row(
            ball["sensor"],
            f"{ball['distance_m']:g}",
            ball["cues"],
            *("-" if ball[key] is None else f"{ball[key]:.2f}" for key in ("rms_mm", "sigma_mm")),
            f"{count}" if not refused else f"{count}; else: {refused[0]}",
            "infinite" if field_m is None else f"{1e3 * field_m:.0f}",
        )
    return shown


def enhanced_line(one: Row) -> str:
    """What clarity of enhanced pictures would cost with one sensor."""
    return (
        f"{one['sensor']}: clarity on the enhanced picture moves the peak by {one['shift_median_steps']:.2f} steps "
        f"in the median, {one['shift_p95_steps']:.2f} at 95 %, {one['shift_mean_steps']:+.2f} on average; "
        f"mean error {one['raw_mae_mm']:.1f} mm raw, {one['enhanced_mae_mm']:.1f} mm enhanced"
    )
