"""`aucamp experiment localization`: how close to the target do robots come together, and how close could they come?

Monte-Carlo in virtual time with the estimators that the agents run (lockstep.py), on worlds and errors of scene.py.
Each case names a protocol, a graph and what goes wrong; its rows give the error at some iterations beside the
Cramer-Rao bound. The error is the root mean square of the 3-D distance to the target over draws and over the robots
that have an estimate, those that are wrong on purpose left out.

All protocols see the same draws, and so does a central fusion whose error is known beforehand: it is the bound. What
that fusion's mean square is off the bound is the luck of these draws, and is taken off everybody's (a control
variate with coefficient 1: unbiased, and tens of draws do the work of thousands for a protocol near the bound).
"""

from __future__ import annotations

import math
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import numpy as np
from rich.table import Table

from agent.experiments.bounds import bound_m, central_m, central_track_m, closed_form_m
from agent.experiments.graphs import graph, metropolis_weights, paper_weights
from agent.experiments.localization_cases import Case, cases
from agent.experiments.localization_figure import draw_iterations
from agent.experiments.localization_targets import verdicts
from agent.experiments.lockstep import Swarm, prior, symmetric
from agent.experiments.result import make_room, write_result
from agent.experiments.scene import TARGET_M, Array, Draw, Scene, draw, lap_m, scene, seen

Progress = Callable[[int, int], None]  # work done, work in all, by `cost`

# One world for all: cases differ in what they name, not in where robots happen to be. Of these draws it is an ordinary
# one: ten robots have a bound of 2.5 mm after one sample each (half of all worlds lie between 2.3 and 2.6), and a mean
# that ignores covariances pays 2.4 times the bound (2.4 to 2.7).
WORLD = 6
DENSITY = 4e-6  # m^2/s^3: acceleration that the filters expect of a moving target
UNIT = 5  # draws in one piece of work


class Score(NamedTuple):
    """One draw at one iteration. Means over the robots that count, in m^2 where squared."""

    square: float | None  # none: no robot has an estimate
    nees: float | None  # e' P^-1 e with the robot's own covariance: 3 when honest
    covered: float  # share of robots with an estimate
    central: float  # square error of the fusion that has everything


def localization(seed: int, out: Path, progress: Progress, quick: bool = False, full: bool = False) -> dict[str, Any]:
    """Run all cases; writes result.json and the figures into `out`, returns the content of result.json.

    quick: a twentieth of the draws and no swarm above ten robots, for a look. full: more draws, losses and robots.
    Raises ConfigError where `out` holds a result already.
    """
    make_room(out)
    chosen = cases(quick, full)
    scores = all_scores(chosen, seed, progress)
    rows = [row for case, found in zip(chosen, scores, strict=True) for row in rows_of(case, found)]
    result = {
        "schema": 1,
        "source": "simulation",
        "seed": seed,
        "world": WORLD,
        "cases": rows,
        "verdicts": verdicts(rows),
    }
    write_result(out, result)
    for loss in (0.0, 0.3):
        draw_iterations(seed, WORLD, loss, out / f"localization_loss_{round(100 * loss)}")
    return result


def all_scores(chosen: Sequence[Case], seed: int, progress: Progress) -> list[list[list[Score]]]:
    """For each case its draws, and of each the scores at case.at. Works on all processors."""
    work = [(n, first) for n, case in enumerate(chosen) for first in range(0, case.draws, UNIT)]
    work.sort(key=lambda item: -cost(chosen[item[0]]))  # the longest first, so that all end together
    found: list[dict[int, list[list[Score]]]] = [{} for _ in chosen]
    total, done = sum(case.draws * cost(case) for case in chosen), 0
    progress(done, total)
    processes = multiprocessing.get_context("spawn")  # a fork would copy the progress bar's thread in mid-step
    with ProcessPoolExecutor(os.cpu_count(), mp_context=processes) as pool:
        jobs = {}
        for n, first in work:
            last = min(first + UNIT, chosen[n].draws)
            jobs[pool.submit(dives, chosen[n], seed, first, last)] = (n, first, last)
        for job in as_completed(jobs):
            n, first, last = jobs[job]
            found[n][first] = job.result()
            done += (last - first) * cost(chosen[n])
            progress(done, total)
    return [[scores for first in sorted(parts) for scores in parts[first]] for parts in found]


def cost(case: Case) -> int:
    """Roughly how long a draw takes: fusing is linear in the origins, there is one fusion per robot, and a target that
    moves is placed anew at every round of messages."""
    fusions = case.at[-1] * case.robots * (case.ticks * case.says if case.speed_mm_s else 1)
    return fusions * (case.robots if case.protocol == "evidence" else 1)


def dives(case: Case, seed: int, first: int, last: int) -> list[list[Score]]:
    """Draws `first` to `last`, the latter excluded."""
    return [dive(case, seed, number) for number in range(first, last)]


def dive(case: Case, seed: int, number: int) -> list[Score]:
    """One draw: its scores at case.at."""
    world = world_of(case)
    rng = np.random.default_rng((seed, number))
    random = Random(f"{seed} {number}")
    if case.speed_mm_s:
        return [chase(case, world, rng, random)]
    samples = draw(world, case.views, case.outlier_mm * 1e-3, case.at[-1], rng)
    rounds = case.ticks * case.says
    return [
        score(swarm, TARGET_M, central_m(world, samples, t, case.honest), case.honest)
        for turn, (t, _, swarm) in enumerate(swim(case, world, samples, random), 1)
        if turn % rounds == 0 and t in case.at
    ]


def chase(case: Case, world: Scene, rng: np.random.Generator, random: Random) -> Score:
    """A target that moves: mean over all iterations of the second half, each against where the target is then."""
    speed_m_s, seconds = case.speed_mm_s * 1e-3, case.at[-1]
    path_m = lap_m(speed_m_s, np.arange(seconds, dtype=np.float64))
    samples = draw(world, case.views, case.outlier_mm * 1e-3, seconds, rng, path_m)
    track = central_track_m(world, samples, DENSITY, case.honest)
    moments = []
    for t, late_s, swarm in swim(case, world, samples, random):
        if 2 * t > seconds:
            truth, state = lap_m(speed_m_s, np.array([t - 1 + late_s]))[0], track[t - 1]
            moments.append(score(swarm, truth, state[:3] + late_s * state[3:], case.honest))
    return mean(moments)


def swim(case: Case, world: Scene, samples: Draw, random: Random) -> Iterator[tuple[int, float, Swarm]]:
    """The swarm after each round of messages: samples so far, seconds since the newest of them, and the swarm."""
    swarm = Swarm(case.protocol, graph(case.topology, case.robots), case.loss, random, 1.0 / case.ticks, case.says)
    own, fixed = symmetric(world.random_m2), symmetric(world.systematic_m2)
    blind = [None] * case.robots
    for k, (measured, sees) in enumerate(zip(samples.sample_m, samples.sees, strict=True)):
        now_ns = swarm.now_ns
        priors = [prior(measured[i], own[i], fixed[i], now_ns) if sees[i] else None for i in range(case.robots)]
        for tick in range(case.ticks):
            swarm.tick(blind if tick else priors)
            for _ in range(case.says):
                late_s = (swarm.now_ns - now_ns) * 1e-9
                swarm.speak()
                yield k + 1, late_s, swarm


def world_of(case: Case) -> Scene:
    return scene(case.robots, case.noise, case.systematic, np.random.default_rng(WORLD))


def score(swarm: Swarm, truth_m: Array, central: Array, honest: slice) -> Score:
    robots = swarm.robots[honest]
    known = [robot.posterior for robot in robots if robot.posterior is not None]
    if not known:
        return Score(None, None, 0.0, float(np.sum((central - truth_m) ** 2)))
    error = np.array([posterior.x_m for posterior in known]) - truth_m
    covariance = np.array([posterior.cov_m2 for posterior in known])[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    square = float(np.sum(error**2, axis=1).mean())
    return Score(square, float(nees.mean()), len(known) / len(robots), float(np.sum((central - truth_m) ** 2)))


def mean(scores: Sequence[Score]) -> Score:
    """Over draws, or over moments of one."""

    def over(values: Sequence[float | None]) -> float | None:
        there = [value for value in values if value is not None]
        return math.fsum(there) / len(there) if there else None

    columns = [over(column) for column in zip(*scores, strict=True)]
    return Score(columns[0], columns[1], columns[2] or 0.0, columns[3] or 0.0)


def rows_of(case: Case, found: Sequence[Sequence[Score]]) -> Iterator[dict[str, Any]]:
    """Rows of result.json: one for each iteration of the case. Millimetres.

    `raw_mm` is the error before, `rmse_mm` after the luck of the draws was taken off; `central_mm` is the error of
    the fusion that has everything. For a target that moves the latter takes the place of the bound, and nothing is
    taken off.
    """
    samples, world = seen(case.views, case.robots, case.at[-1]), world_of(case)
    for t, scores in zip(case.at, zip(*found, strict=True), strict=True):
        of_all = mean(scores)
        central_mm = 1e3 * math.sqrt(of_all.central)
        bound_mm = central_mm if case.speed_mm_s else 1e3 * bound_m(world, samples[:t].sum(axis=0), case.honest)
        raw_mm = None if of_all.square is None else 1e3 * math.sqrt(of_all.square)
        rmse_mm = None if raw_mm is None else math.sqrt(max(0.0, raw_mm**2 - central_mm**2 + bound_mm**2))
        theory = closed_form_mm(case, world, t)
        yield {
            **case.named(),
            "t": t,
            "rmse_mm": rmse_mm,
            "bound_mm": bound_mm,
            "ratio": None if rmse_mm is None else rmse_mm / bound_mm,
            "nees": of_all.nees,
            "covered": of_all.covered,
            "raw_mm": raw_mm,
            "central_mm": central_mm,
            **({} if theory is None else {"closed_form_mm": theory}),
        }


def closed_form_mm(case: Case, world: Scene, t: int) -> float | None:
    """What averaging must reach where the theorem applies: all see, nothing is lost, nothing is biased."""
    if case.loss or case.views != "all" or case.systematic or case.outlier_mm or case.speed_mm_s:
        return None
    weights = {"paper": paper_weights, "metropolis": metropolis_weights}.get(case.protocol)
    if weights is None:
        return None
    return 1e3 * closed_form_m(weights(graph(case.topology, case.robots)), world.random_m2, t)


def table(result: dict[str, Any]) -> Table:
    """The rows as they are shown on the console."""
    shown = Table(title="localization: error of the swarm against the Cramer-Rao bound (simulation)")
    heads = ("protocol", "graph", "robots", "noise", "loss", "views", "what else")
    for head in (*heads, "t", "rmse mm", "bound mm", "ratio", "NEES", "covered"):
        shown.add_column(head, justify="left" if head in heads[:2] else "right")
    for row in result["cases"]:
        else_ = (
            "biased" if row["systematic"] else "",
            f"one {row['outlier_mm']:g} mm off" if row["outlier_mm"] else "",
            f"{row['says']} messages" if row["says"] > 1 else "",
            f"{row['speed_mm_s']:g} mm/s, iterations of {1 / row['ticks']:g} s" if row["speed_mm_s"] else "",
            f"theory {row['closed_form_mm']:.2f} mm" if "closed_form_mm" in row else "",
        )
        names = (row["protocol"], row["topology"], str(row["robots"]), row["noise"], f"{row['loss']:.0%}", row["views"])
        figures = (number(row["rmse_mm"]), number(row["bound_mm"]), number(row["ratio"]), number(row["nees"], 1))
        shown.add_row(*names, ", ".join(e for e in else_ if e), str(row["t"]), *figures, f"{row['covered']:.0%}")
    return shown


def verdict_table(result: dict[str, Any]) -> Table:
    """Each target of localization_targets.py beside what was measured."""
    shown = Table(title="targets")
    for head in ("target", "case", "draws", "t", "asked", "measured", "met"):
        shown.add_column(head, justify="left" if head in ("target", "case") else "right")
    for verdict in result["verdicts"]:
        low, high = verdict["least"], verdict["most"]
        asked = f"{low:g} to {high:g}" if low and high else f">= {low:g}" if low else f"<= {high:g}"
        measured, met = number(verdict["measured"], 3), "yes" if verdict["met"] else "no"
        draws, t = str(verdict["draws"]), str(verdict["t"])
        shown.add_row(verdict["target"], verdict["case"], draws, t, asked, measured, met)
    return shown


def number(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
