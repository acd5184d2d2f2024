"""The orientation experiment's result as two tables for the terminal."""

from __future__ import annotations

from typing import Any

from rich.table import Table

COLUMNS = (
    "push s, median",
    "p95",
    "never",
    "step s, median",
    "p95",
    "never",
    "hover mm rms",
    "deg rms",
    "tilt deg",
    "overshoot mm",
)


def controllers_table(result: dict[str, Any]) -> Table:
    """Laws by lags."""
    table = Table(title="push of 8 N for 0.3 s at a corner, and step from 0.22 to 0.41 m (twin)")
    for column in ("law", "lag s", *COLUMNS):
        table.add_column(column, justify="left" if column == "law" else "right")
    for lag_s, laws in result["by_lag_s"].items():
        for law, figures in laws.items():
            table.add_row(law, lag_s, *cells(figures))
    return table


def stability_table(result: dict[str, Any]) -> Table:
    """Masses by delays."""
    table = Table(title=f"{result['stability'][0]['law']} on robots that it does not know")
    for column in ("mass", "delay, samples", *COLUMNS):
        table.add_column(column, justify="right")
    for line in result["stability"]:
        table.add_row(f"x {line['mass_scale']}", str(line["delay_samples"]), *cells(line))
    return table


def cells(figures: dict[str, Any]) -> list[str]:
    """One law's figures in the order of COLUMNS."""
    push, step = figures["push_recovery_s"], figures["step_settle_s"]
    times = [text for s in (push, step) for text in (number(s["median"]), number(s["p95"]), str(s["never"]))]
    return [
        *times,
        number(figures["hover_depth_rms_mm"]),
        number(figures["hover_tilt_rms_deg"]),
        f"{figures['worst_push_tilt_deg']:.0f}",
        f"{figures['worst_overshoot_mm']:.0f}",
    ]


def number(value: float | None) -> str:
    return "never" if value is None else f"{value:.2f}"
