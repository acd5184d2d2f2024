"""How close to the target do robots come together, and how close could they come?

Monte-Carlo in virtual time with the estimators that the agents run, on worlds and errors of lockstep.py.
Each case names a protocol, a graph and what goes wrong; its rows give the error at some iterations beside the
Cramer-Rao bound. The error is the root mean square of the 3-D distance to the target over draws and over the robots
that have an estimate, those that are wrong on purpose left out.

All protocols see the same draws, and so does a central fusion that has every sample; its error is known beforehand: it
is the bound. What its mean square is off the bound is the luck of these draws, and is taken off all others' (a control
variate with coefficient 1: unbiased, and tens of draws do the work of thousands for a protocol near the bound).

The other kind of case has robots that lie, as well as they can (liar.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial
from random import Random

import msgspec
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich.console import Group
from rich.table import Table

from agent.core.config import Protocol
from agent.core.messages import Symmetric
from agent.experiments.experiment import ExperimentResult, Figures, LocalizationKind, Row, Task, all_draws
from agent.experiments.localization.draws import (
    WORLD,
    Case,
    Score,
    bound_m,
    cases,
    closed_form_m,
    mean_score,
    score_draws,
    verdicts,
    world_of,
)
from agent.experiments.localization.liar import liar_cases
from agent.experiments.localization.liar_rows import UNIT as LIAR_UNIT
from agent.experiments.localization.liar_rows import attack_draws, liar_cost, liar_row, liar_verdicts, lie
from agent.experiments.localization.lockstep import (
    TARGET_M,
    THREE_M,
    Array,
    Dive,
    MonteCarloWorld,
    Swarm,
    draw_dive,
    draw_world,
    graph,
    metropolis_weights,
    paper_weights,
    prior,
    seen,
    symmetric,
)
from agent.process.command import Progress

UNIT = 5  # draws in one piece of work


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # of the draws
    quick: bool = False  # a twentieth of the draws and no swarm above ten robots, for a look
    full: bool = False  # more draws, losses and robots
    only: LocalizationKind | None = None  # this kind of case; none: all


class Result(ExperimentResult, frozen=True, kw_only=True):
    """A row in `cases` for each case and iteration, one in `liars` for each case in which robots lie or are knocked; a
    verdict for each target and row that it is about."""

    schema: int = 1
    source: str = "simulation"
    seed: int
    world: int = WORLD
    cases: list[Row]
    liars: list[Row]
    verdicts: list[Row] | None  # None: too few draws to tell

    @property
    def failed(self) -> bool:
        return any(not verdict["met"] for verdict in self.verdicts or [])


def run(settings: Settings, progress: Progress) -> Result:
    """Run all cases; progress counts draws by their `cost`."""
    seed, quick, full = settings.seed, settings.quick, settings.full
    chosen = [] if settings.only == "liar" else cases(quick, full)
    lies = [] if settings.only == "accuracy" else liar_cases(quick, full)
    found = all_draws(
        [
            *(Task(partial(score_draws, case, seed), case.draws, cost(case), UNIT) for case in chosen),
            *(Task(partial(attack_draws, case, seed), case.draws, liar_cost(case), LIAR_UNIT) for case in lies),
        ],
        progress,
    )
    rows = [row for case, scores in zip(chosen, found, strict=False) for row in rows_of(case, scores)]
    told = [liar_row(case, outcomes) for case, outcomes in zip(lies, found[len(chosen) :], strict=True)]
    judged = None if quick else [*verdicts(rows), *liar_verdicts(told)]
    return Result(seed=seed, cases=rows, liars=told, verdicts=judged)


def cost(case: Case) -> int:
    """Roughly how long a draw takes: fusing is linear in the origins, there is one fusion per robot, and a target that
    moves is placed anew at every round of messages."""
    fusions = case.at[-1] * case.robots * (case.ticks * case.says if case.speed_mm_s else 1)
    return fusions * (case.robots if case.protocol == "evidence" else 1)


def rows_of(case: Case, found: Sequence[Sequence[Score]]) -> Iterator[Row]:
    """Rows of result.json: one for each iteration of the case. Millimetres.

    `raw_mm` is the error before, `rmse_mm` after the luck of the draws was taken off; `central_mm` is the error of
    the fusion that has everything. For a target that moves the latter takes the place of the bound, and nothing is
    taken off.
    """
    samples, world = seen(case.views, case.robots, case.at[-1]), world_of(case)
    for t, scores in zip(case.at, zip(*found, strict=True), strict=True):
        mean = mean_score(scores)
        central_mm = 1e3 * math.sqrt(mean.central)
        bound_mm = central_mm if case.speed_mm_s else 1e3 * bound_m(world, samples[:t].sum(axis=0), case.honest)
        raw_mm = None if mean.square is None else 1e3 * math.sqrt(mean.square)
        rmse_mm = None if raw_mm is None else math.sqrt(max(0.0, raw_mm**2 - central_mm**2 + bound_mm**2))
        theory_mm = closed_form_mm(case, world, t)
        yield {
            **case.named(),
            "t": t,
            "rmse_mm": rmse_mm,
            "bound_mm": bound_mm,
            "ratio": None if rmse_mm is None else rmse_mm / bound_mm,
            "nees": mean.nees,
            "covered": mean.covered,
            "raw_mm": raw_mm,
            "central_mm": central_mm,
            **({} if theory_mm is None else {"closed_form_mm": theory_mm}),
        }


def closed_form_mm(case: Case, world: MonteCarloWorld, t: int) -> float | None:
    """What averaging must reach where the theorem applies: all see, nothing is lost, nothing is biased."""
    if case.loss or case.views != "all" or case.systematic or case.outlier_mm or case.speed_mm_s:
        return None
    weights = {"paper": paper_weights, "metropolis": metropolis_weights}.get(case.protocol)
    if weights is None:
        return None
    return 1e3 * closed_form_m(weights(graph(case.topology, case.robots)), world.random_m2, t)


# --- tables ---


def table(result: Result) -> Group:
    """Errors beside their bounds for each kind of case that was run, and the verdicts."""
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
    """Each target beside what was measured."""
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


# --- figures: prior and posterior of each axis against the iteration, each robot's first view marked ---

ITERATIONS = 60
AXES = "xyz"
LINES: tuple[Protocol, ...] = ("paper", "evidence")


def figures(result: Result) -> Figures:
    """The paper's figure, once without loss and once with 30 %, each as SVG and PNG."""
    for loss in (0.0, 0.3):
        drawn = figure(result.seed, result.world, loss)
        for suffix in ("svg", "png"):
            yield f"localization_loss_{round(100 * loss)}.{suffix}", drawn


def figure(seed: int, world_seed: int, loss: float) -> Figure:
    """One dive of the paper's three robots, the same samples under both protocols."""
    robots = len(THREE_M)
    world = draw_world(robots, "aniso", False, np.random.default_rng(world_seed))
    dive = draw_dive(world, "paper", 0.0, ITERATIONS, np.random.default_rng((seed, 0)))
    drawn = Figure(figsize=(3.6 * robots, 7.5), dpi=120, layout="constrained")
    drawn.suptitle(f"three robots, {loss:.0%} of the messages lost; millimetres from the target (simulation)")
    panels = drawn.subplots(len(AXES), robots, sharex=True, sharey="row")
    lines = {protocol: posteriors(protocol, dive, symmetric(world.random_m2), loss, seed) for protocol in LINES}
    for i in range(robots):
        panels[0, i].set_title(f"r{i + 1}")
        panels[-1, i].set_xlabel("iteration")
        for axis in range(len(AXES)):
            draw_axis(panels[axis, i], dive, lines, i, axis)
    for axis, name in enumerate(AXES):
        panels[axis, 0].set_ylabel(f"{name}, mm")
    panels[0, 0].legend(fontsize="small", loc="upper right")
    return drawn


def posteriors(protocol: Protocol, dive: Dive, random_m2: Sequence[Symmetric], loss: float, seed: int) -> Array:
    """What each robot believed after each iteration, (T, N, 3); NaN while it believed nothing."""
    robots = len(random_m2)
    swarm = Swarm(protocol, graph("full", robots), loss, Random(seed))
    zero = symmetric(np.zeros((robots, 3, 3)))
    believed = np.full(dive.sample_m.shape, np.nan)
    for k, (measured, sees) in enumerate(zip(dive.sample_m, dive.sees, strict=True)):
        swarm.iterate(
            [prior(measured[i], random_m2[i], zero[i], swarm.now_ns) if sees[i] else None for i in range(robots)]
        )
        for i, robot in enumerate(swarm.robots):
            if robot.posterior is not None:
                believed[k, i] = robot.posterior.x_m
    return believed


def draw_axis(panel: Axes, dive: Dive, lines: dict[Protocol, Array], i: int, axis: int) -> None:
    """Robot i, one of x, y and z; millimetres from the target."""
    t = np.arange(1, len(dive.sees) + 1)
    sees = dive.sees[:, i]
    off = 1e3 * (dive.sample_m[:, i, axis] - TARGET_M[axis])
    panel.plot(t[sees], off[sees], ".", color="0.65", markersize=3, label="prior")
    for protocol, believed in lines.items():
        panel.plot(t, 1e3 * (believed[:, i, axis] - TARGET_M[axis]), linewidth=1.2, label=f"posterior, {protocol}")
    panel.axhline(0.0, color="black", linewidth=0.6, linestyle="--")
    panel.axvline(float(t[sees][0]), color="C3", linewidth=0.8, label="first view")
