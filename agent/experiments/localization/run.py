"""How close to the target do robots come together, and how close could they come?

Monte-Carlo in virtual time with the estimators that the agents run (lockstep.py), on worlds and errors of world.py.
Each case names a protocol, a graph and what goes wrong; its rows give the error at some iterations beside the
Cramer-Rao bound. The error is the root mean square of the 3-D distance to the target over draws and over the robots
that have an estimate, those that are wrong on purpose left out.

All protocols see the same draws, and so does a central fusion that has every sample; its error is known beforehand: it
is the bound. What its mean square is off the bound is the luck of these draws, and is taken off everybody's (a control
variate with coefficient 1: unbiased, and tens of draws do the work of thousands for a protocol near the bound).

The other kind of case has robots that lie, as well as they can (liar.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from functools import partial

import msgspec

from agent.experiments.choices import LocalizationKind
from agent.experiments.localization.bounds import bound_m, closed_form_m
from agent.experiments.localization.cases import Case, cases
from agent.experiments.localization.criteria import verdicts
from agent.experiments.localization.draws import WORLD, Score, mean_score, score_draws, world_of
from agent.experiments.localization.graphs import graph, metropolis_weights, paper_weights
from agent.experiments.localization.liar_cases import liar_cases
from agent.experiments.localization.liar_rows import UNIT as LIAR_UNIT
from agent.experiments.localization.liar_rows import attack_draws, liar_cost, liar_row, liar_verdicts
from agent.experiments.localization.world import MonteCarloWorld, seen
from agent.experiments.pieces import Task, all_draws
from agent.experiments.result import ExperimentResult, Row
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
