"""`aucamp experiment consistency` at the terminal: a bar while it runs, then normalised errors by range and cue."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from agent.experiments.consistency import EXPECTED, consistency
from agent.launch import run_folder, with_bar


def run(seed: int, count: int, out: Path | None, console: Console) -> bool:
    """Run the experiment into `out` or runs/<UTC>; whether the mean with both cues lies where it should."""
    folder = run_folder(out)
    result = with_bar(console, "measurements", lambda show: consistency(seed, count, folder, show))
    console.print(table(result["cases"]))
    for reason, times in refusals(result["measurements"]).most_common():
        console.print(f"no measurement, {times} times: {reason}")
    console.print(f"written to {folder}")
    whole = next(case for case in reversed(result["cases"]) if case["cues"] == "both")
    honest = whole["nees"] is not None and EXPECTED[0] <= whole["nees"] <= EXPECTED[1]
    if not honest:
        console.print(f"missed: the mean with both cues is not within {EXPECTED[0]:g} to {EXPECTED[1]:g}")
    return honest


def refusals(measurements: list[dict[str, Any]]) -> Counter[str]:
    """Why there was no measurement, numbers left out so that like counts with like."""
    reasons = (one["both"]["refused"] for one in measurements if "refused" in one["both"])
    return Counter("".join("#" if c.isdigit() else c for c in reason) for reason in reasons)


def table(cases: list[dict[str, Any]]) -> Table:
    table = Table(title="normalised error squared: 3 is honest, more is boastful, less is timid")
    for column in ("cues", "range m", "measured", "mean", "median (2.37)", "rms error mm", "stated sigma mm"):
        table.add_column(column, justify="left" if column == "cues" else "right")
    for case in cases:
        low, high = case["range_m"]
        figures = (case[key] for key in ("nees", "nees_median", "error_rms_mm", "sigma_mm"))
        table.add_row(
            case["cues"],
            f"{low:g} to {high:g}",
            f"{case['measured']} of {case['count']}",
            *("-" if value is None else f"{value:.2f}" for value in figures),
        )
    return table
