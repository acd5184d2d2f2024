"""Laws by lags, and the default law on robots that it does not know."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from agent.experiments.orientation.run import DEFAULT_LAW, ENOUGH, Result
from agent.experiments.result import Row
from agent.experiments.spread import number_or_never

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


def table(result: Result) -> Group:
    """Both tables, targets that are missed, and whose firmware it was."""
    return Group(
        controllers_table(result),
        stability_table(result),
        *(f"{DEFAULT_LAW} misses: {text}" for text in result.missed or []),
        *([f"no verdict: the targets are for {ENOUGH} robots a case"] if result.missed is None else []),
        f"twin, firmware under {result.firmware}, {result.seeds} seeds",
    )


def controllers_table(result: Result) -> Table:
    """A line for each lag and law."""
    shown = Table(title="push of 8 N for 0.3 s at a corner, and step from 0.22 to 0.41 m (twin)")
    for column in ("law", "lag s", *COLUMNS):
        shown.add_column(column, justify="left" if column == "law" else "right")
    for lag_s, laws in result.by_lag_s.items():
        for law, figures in laws.items():
            shown.add_row(law, lag_s, *cells(figures))
    return shown


def stability_table(result: Result) -> Table:
    """A line for each mass and delay."""
    shown = Table(title=f"{DEFAULT_LAW} on robots that it does not know")
    for column in ("mass", "delay, samples", *COLUMNS):
        shown.add_column(column, justify="right")
    for line in result.stability:
        shown.add_row(f"x {line['mass_scale']}", str(line["delay_samples"]), *cells(line))
    return shown


def cells(figures: Row) -> list[str]:
    """One law's figures in the order of COLUMNS."""
    push, step = figures["push_recovery_s"], figures["step_settle_s"]
    times = [
        text
        for s in (push, step)
        for text in (number_or_never(s["median"]), number_or_never(s["p95"]), str(s["never"]))
    ]
    return [
        *times,
        number_or_never(figures["hover_depth_rms_mm"]),
        number_or_never(figures["hover_tilt_rms_deg"]),
        f"{figures['worst_push_tilt_deg']:.0f}",
        f"{figures['worst_overshoot_mm']:.0f}",
    ]
