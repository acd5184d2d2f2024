"""The tables of the experiment: by distance, by fleets, and how good the models are."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table

from agent.experiments.lighting.bars import ENOUGH
from agent.experiments.lighting.run import Result
from agent.experiments.result import Row


def table(result: Result) -> RenderableType:
    """All of them."""
    verdict = "no verdict, too few fleets" if result.scenes < ENOUGH else "; ".join(result.missed) or "nothing"
    return Group(_ladder(result), _fleets(result), _model(result), f"targets missed: {verdict}")


def _millimetres(row: Row) -> str:
    sigma = "-" if row["sigma_mm"] is None else f"{row['sigma_mm']:.1f}"
    return sigma if row["accepted"] > 0.99 else f"{sigma} ({100 * row['accepted']:.0f} %)"


def _ladder(result: Result) -> Table:
    rows = [row for row in result.cases if row["distance_m"] is not None]
    policies = list(dict.fromkeys(row["policy"] for row in rows))
    shown = Table(
        title="Sigma of the range, mm, and how many sweeps have a peak; neighbours' lamps 0.6 m from the ball"
    )
    for column in ("water", "distance", *policies):
        shown.add_column(column, justify="left" if column == "water" else "right")
    for water, distance_m in dict.fromkeys((row["water"], row["distance_m"]) for row in rows):
        of = {row["policy"]: row for row in rows if (row["water"], row["distance_m"]) == (water, distance_m)}
        shown.add_row(water, f"{distance_m:.2f} m", *(_millimetres(of[policy]) for policy in policies))
    return shown


def _fleets(result: Result) -> Table:
    rows = [row for row in result.cases if row["distance_m"] is None]
    kinds = list(dict.fromkeys((row["policy"], row["loss"]) for row in rows))
    shown = Table(title=f"Robots with a usable range, {result.scenes} fleets of each size at random places, in turn")
    shown.add_column("water")
    shown.add_column("robots", justify="right")
    for policy, loss in kinds:
        shown.add_column(policy + (f", {100 * loss:.0f} % lost" if loss else ""), justify="right")
    for water, robots in dict.fromkeys((row["water"], row["robots"]) for row in rows):
        of = {(row["policy"], row["loss"]): row for row in rows if (row["water"], row["robots"]) == (water, robots)}
        shown.add_row(water, str(robots), *(f"{100 * of[kind]['usable_share']:.0f} %" for kind in kinds))
    return shown


def _model(result: Result) -> Table:
    model = result.model
    shown = Table(title="The models, worst of 4 geometries in each water against Monte Carlo")
    for column in ("", "kernel", "twin"):
        shown.add_column(column, justify="left" if not column else "right")
    for label, key in (("veil, one order", "veil_first_order"), ("veil, all orders", "veil_all_orders")):
        shown.add_row(label, f"{100 * model[key]:.1f} %", f"{100 * model['twin_' + key]:.1f} %")
    shown.add_row("one more lamp in a frame", "", f"{model['ms_per_lamp']:.1f} ms")
    for water, value in model["correlation"].items():
        shown.add_row(f"log J with log sigma, {water}", "-" if value is None else f"{value:.2f}", "")
    return shown
