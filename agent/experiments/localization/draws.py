"""One Monte-Carlo draw: a swarm goes through the samples of a dive, and its posteriors are scored."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from random import Random
from typing import NamedTuple

import numpy as np

from agent.experiments.localization.bounds import central_m, central_track_m
from agent.experiments.localization.cases import Case
from agent.experiments.localization.graphs import graph
from agent.experiments.localization.lockstep import Swarm, prior, symmetric
from agent.experiments.localization.world import (
    TARGET_M,
    Array,
    Dive,
    MonteCarloWorld,
    circle_m,
    draw_dive,
    draw_world,
)

# One world for all: cases differ in what they name, not in where robots happen to be. Of these draws it is an ordinary
# one: ten robots have a bound of 2.5 mm after one sample each (half of all worlds lie between 2.3 and 2.6), and a mean
# that ignores covariances pays 2.4 times the bound (2.4 to 2.7).
WORLD = 6
DENSITY = 4e-6  # m^2/s^3: acceleration that the filters expect of a moving target


class Score(NamedTuple):
    """One draw at one iteration. Means over the robots that count, in m^2 where squared."""

    square: float | None  # none: no robot has an estimate
    nees: float | None  # e' P^-1 e with the robot's own covariance: 3 when honest
    covered: float  # share of robots with an estimate
    central: float  # square error of the fusion that has everything


def world_of(case: Case) -> MonteCarloWorld:
    """The one world, with as many robots as the case has."""
    return draw_world(case.robots, case.noise, case.systematic, np.random.default_rng(WORLD))


def score_draws(case: Case, seed: int, first: int, last: int) -> list[list[Score]]:
    """Draws `first` to `last`, the latter excluded: of each its scores at case.at."""
    return [score_draw(case, seed, number) for number in range(first, last)]


def score_draw(case: Case, seed: int, number: int) -> list[Score]:
    """One draw: its scores at case.at."""
    world = world_of(case)
    rng = np.random.default_rng((seed, number))
    random = Random(f"{seed} {number}")
    if case.speed_mm_s:
        return [score_moving_target(case, world, rng, random)]
    dive = draw_dive(world, case.views, case.outlier_mm * 1e-3, case.at[-1], rng)
    rounds = case.ticks * case.says
    return [
        score(swarm, TARGET_M, central_m(world, dive, t, case.honest), case.honest)
        for k, (t, _, swarm) in enumerate(message_rounds(case, world, dive, random), 1)
        if k % rounds == 0 and t in case.at
    ]


def score_moving_target(case: Case, world: MonteCarloWorld, rng: np.random.Generator, random: Random) -> Score:
    """Mean over all rounds of the second half, each against where the target is then."""
    speed_m_s, seconds = case.speed_mm_s * 1e-3, case.at[-1]
    path_m = circle_m(speed_m_s, np.arange(seconds, dtype=np.float64))
    dive = draw_dive(world, case.views, case.outlier_mm * 1e-3, seconds, rng, path_m)
    track = central_track_m(world, dive, DENSITY, case.honest)
    scores = []
    for t, late_s, swarm in message_rounds(case, world, dive, random):
        if 2 * t > seconds:
            truth_m, state = circle_m(speed_m_s, np.array([t - 1 + late_s]))[0], track[t - 1]
            scores.append(score(swarm, truth_m, state[:3] + late_s * state[3:], case.honest))
    return mean_score(scores)


def message_rounds(
    case: Case, world: MonteCarloWorld, dive: Dive, random: Random
) -> Iterator[tuple[int, float, Swarm]]:
    """The swarm after each round of messages: samples so far, seconds since the newest of them, and the swarm."""
    swarm = Swarm(case.protocol, graph(case.topology, case.robots), case.loss, random, 1.0 / case.ticks, case.says)
    own, fixed = symmetric(world.random_m2), symmetric(world.systematic_m2)
    blind = [None] * case.robots
    for k, (measured, sees) in enumerate(zip(dive.sample_m, dive.sees, strict=True)):
        now_ns = swarm.now_ns
        priors = [prior(measured[i], own[i], fixed[i], now_ns) if sees[i] else None for i in range(case.robots)]
        for tick in range(case.ticks):
            swarm.tick(blind if tick else priors)
            for _ in range(case.says):
                late_s = (swarm.now_ns - now_ns) * 1e-9
                swarm.speak()
                yield k + 1, late_s, swarm


def score(swarm: Swarm, truth_m: Array, central: Array, honest: slice) -> Score:
    """The swarm's posteriors now, and the central fusion `central` (3,), against the truth (3,), metres."""
    robots = swarm.robots[honest]
    known = [robot.posterior for robot in robots if robot.posterior is not None]
    if not known:
        return Score(None, None, 0.0, float(np.sum((central - truth_m) ** 2)))
    error = np.array([posterior.x_m for posterior in known]) - truth_m
    covariance = np.array([posterior.cov_m2 for posterior in known])[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    square = float(np.sum(error**2, axis=1).mean())
    return Score(square, float(nees.mean()), len(known) / len(robots), float(np.sum((central - truth_m) ** 2)))


def mean_score(scores: Sequence[Score]) -> Score:
    """The mean over draws, or over rounds of one; what does not exist is left out."""

    def over(values: Sequence[float | None]) -> float | None:
        there = [value for value in values if value is not None]
        return math.fsum(there) / len(there) if there else None

    columns = [over(column) for column in zip(*scores, strict=True)]
    return Score(columns[0], columns[1], columns[2] or 0.0, columns[3] or 0.0)
