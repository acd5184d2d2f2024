"""`aucamp experiment depth` at the terminal: a bar while it runs, the table of its cases, and what was missed."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from agent.experiments.depth import depth
from agent.launch import run_folder, with_bar


def run(seed: int, out: Path | None, console: Console) -> dict[str, Any]:
    """Run the experiment into `out` or runs/<UTC>; returns the content of result.json."""
    folder = run_folder(out)
    result = with_bar(console, "sweeps of whole views", lambda show: depth(seed, folder, show))
    console.print(cases_table(result["cases"]))
    console.print(balls_table(result["balls"]))
    for one in result["enhanced"]:
        console.print(
            f"{one['sensor']}: clarity on the enhanced picture moves the peak by {one['shift_median_steps']:.2f} steps "
            f"in the median, {one['shift_p95_steps']:.2f} at 95 %, {one['shift_mean_steps']:+.2f} on average; "
            f"mean error {one['raw_mae_mm']:.1f} mm raw, {one['enhanced_mae_mm']:.1f} mm enhanced"
        )
    for text in result["missed"]:
        console.print(f"missed: {text}")
    console.print(f"written to {folder}")
    return result


def cases_table(cases: list[dict[str, Any]]) -> Table:
    table = Table(title="depth from focus against the twin's truth")
    for column in ("sensor", "peak", "range m", "mean error mm", "median mm", "accepted"):
        table.add_column(column, justify="left" if column in ("sensor", "peak") else "right")
    for case in cases:
        low, high = case["range_m"]
        errors = (case["mae_mm"], case["median_mm"])
        table.add_row(
            case["sensor"],
            case["peak"] + (", grid not growing" if case.get("grid") == "fixed" else ""),
            f"{low:g} to {high:g}",
            *(f"{v:.1f}" if v is not None else "-" for v in errors),
            f"{100 * case['accepted']:.0f} %" if isinstance(case["accepted"], float) else str(case["accepted"]),
        )
    return table


def balls_table(balls: list[dict[str, Any]]) -> Table:
    table = Table(title="one ball, range from focus, from size, and from both")
    for column in ("sensor", "range m", "cues", "rms error mm", "stated sigma mm", "measured", "depth of field mm"):
        table.add_column(column, justify="left" if column in ("sensor", "cues", "measured") else "right")
    for ball in balls:
        count, refused, field_m = len(ball["errors_mm"]), ball["refused"], ball["depth_of_field_m"]
        table.add_row(
            ball["sensor"],
            f"{ball['distance_m']:g}",
            ball["cues"],
            *("-" if ball[key] is None else f"{ball[key]:.2f}" for key in ("rms_mm", "sigma_mm")),
            f"{count}" if not refused else f"{count}; else: {refused[0]}",
            "infinite" if field_m is None else f"{1e3 * field_m:.0f}",
        )
    return table
