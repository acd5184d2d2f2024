"""Errors beside their bounds, and targets beside what was measured."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from agent.experiments.localization.liar_rows import lie
from agent.experiments.localization.run import Result
from agent.experiments.result import Row


def table(result: Result) -> Group:
    """A table for each kind of case that was run, and the verdicts."""
    shown = [cases_table(result.cases)] if result.cases else []
    shown += [liars_table(result.liars)] if result.liars else []
    if result.verdicts is None:
        return Group(*shown, "no verdict: --quick makes too few draws to hold anything against its target")
    return Group(*shown, verdicts_table(result.verdicts))


def cases_table(rows: list[Row]) -> Table:
    """A line for each case and iteration."""
    shown = Table(title="localization: error of the swarm against the Cramer-Rao bound (simulation)")
    heads = ("protocol", "graph", "robots", "noise", "loss", "views", "what else")
    for head in (*heads, "t", "rmse mm", "bound mm", "ratio", "NEES", "covered"):
        shown.add_column(head, justify="left" if head in heads[:2] else "right")
    for row in rows:
        names = (row["protocol"], row["topology"], str(row["robots"]), row["noise"], f"{row['loss']:.0%}", row["views"])
        figures = (number(row["rmse_mm"]), number(row["bound_mm"]), number(row["ratio"]), number(row["nees"], 1))
        shown.add_row(*names, what_else(row), str(row["t"]), *figures, f"{row['covered']:.0%}")
    return shown


def liars_table(rows: list[Row]) -> Table:
    """A line for each case."""
    shown = Table(title="localization: how far a liar moves the honest, millimetres (simulation)")
    heads = ("protocol", "graph", "robots", "what")
    for head in (*heads, "draws", "median", "95 %", "max", "bound", "over bound", "10 later", "share"):
        shown.add_column(head, justify="left" if head in ("protocol", "graph", "what") else "right")
    for row in rows:
        names = (row["protocol"], row["topology"], str(row["robots"]), lie(row).removeprefix(", ") or "one liar")
        moved = (number(row[f"moved_{which}_mm"], 1) for which in ("median", "p95", "max"))
        against = (number(row["bound_median_mm"], 1), number(row["ratio_max"]))
        later = (number(row["after_10_max_mm"], 1), number(row["share_median"]))
        shown.add_row(*names, str(row["draws"]), *moved, *against, *later)
    return shown


def what_else(row: Row) -> str:
    """What goes wrong in a case beyond the columns, and what theory says of it."""
    parts = (
        "biased" if row["systematic"] else "",
        f"one {row['outlier_mm']:g} mm off" if row["outlier_mm"] else "",
        f"{row['says']} messages" if row["says"] > 1 else "",
        f"{row['speed_mm_s']:g} mm/s, iterations of {1 / row['ticks']:g} s" if row["speed_mm_s"] else "",
        f"theory {row['closed_form_mm']:.2f} mm" if "closed_form_mm" in row else "",
    )
    return ", ".join(part for part in parts if part)


def verdicts_table(verdicts: list[Row]) -> Table:
    """Each target of targets.py beside what was measured."""
    shown = Table(title="targets")
    for head in ("target", "case", "draws", "t", "asked", "measured", "met"):
        shown.add_column(head, justify="left" if head in ("target", "case") else "right")
    for verdict in verdicts:
        low, high = verdict["least"], verdict["most"]
        asked = f"{low:g} to {high:g}" if low and high else f">= {low:g}" if low else f"<= {high:g}"
        measured, met = number(verdict["measured"], 3), "yes" if verdict["met"] else "no"
        draws, t = str(verdict["draws"]), "-" if verdict["t"] is None else str(verdict["t"])
        shown.add_row(verdict["target"], verdict["case"], draws, t, asked, measured, met)
    return shown


def number(value: float | None, digits: int = 2) -> str:
    """A dash where there is none."""
    return "-" if value is None else f"{value:.{digits}f}"
