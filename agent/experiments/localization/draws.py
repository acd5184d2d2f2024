"""Monte Carlo draws of swarms that look for a target together, and the best that any fusion could do.

In a draw a swarm goes through the samples of a dive, and its posteriors are scored beside those of a central fusion
that has every sample. Lengths are metres, covariances m^2; every root mean square is over the three axes together.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from random import Random
from typing import NamedTuple

import numpy as np

from agent.core.config import Protocol
from agent.experiments.localization.lockstep import (
    TARGET_M,
    Array,
    Dive,
    Matrix,
    MonteCarloWorld,
    Noise,
    Swarm,
    Topology,
    Views,
    circle_m,
    draw_dive,
    draw_world,
    graph,
    prior,
    symmetric,
)


class Case(NamedTuple):
    """One protocol in one situation; `at` are the iterations at which it is scored, in ascending order."""

    protocol: Protocol
    topology: Topology
    robots: int
    draws: int  # of a seed
    at: tuple[int, ...]
    noise: Noise = "aniso"
    loss: float = 0.0
    views: Views = "all"
    systematic: bool = False  # errors that do not average out, on every robot
    outlier_mm: float = 0.0  # robot 0 is wrong by this much and does not know it
    speed_mm_s: float = 0.0  # of the target, on a circle
    says: int = 1  # messages to each neighbour in one iteration
    ticks: int = 1  # iterations for each sample, which takes a second: one measures, all exchange

    @property
    def honest(self) -> slice:
        """The robots that count."""
        return slice(1, None) if self.outlier_mm else slice(None)


# --- bounds: what the best possible fusion would reach, and what the paper's update must reach ---


def bound_m(world: MonteCarloWorld, samples: Array, honest: slice = slice(None)) -> float:
    """The Cramer-Rao bound with `samples` of each robot, (N,), from those `honest`.

    A robot's mean has covariance R / n + B, the systematic B undivided; unbiased fusion adds up their inverses.
    """
    counted = np.flatnonzero((samples > 0) & _mask(len(samples), honest))
    mean = world.random_m2[counted] / samples[counted, None, None] + world.systematic_m2[counted]
    return math.sqrt(np.trace(np.linalg.inv(np.linalg.inv(mean).sum(axis=0))))


def central_m(world: MonteCarloWorld, dive: Dive, iterations: int, honest: slice = slice(None)) -> Array:
    """The estimate (3,) of a fusion that has every sample and every covariance: it meets the bound."""
    sees = dive.sees[:iterations]
    n = sees.sum(axis=0)
    counted = np.flatnonzero((n > 0) & _mask(len(n), honest))
    mean = (dive.sample_m[:iterations] * sees[:, :, None]).sum(axis=0)[counted] / n[counted, None]
    weight = np.linalg.inv(world.random_m2[counted] / n[counted, None, None] + world.systematic_m2[counted])
    return np.asarray(np.linalg.solve(weight.sum(axis=0), np.einsum("nij,nj->i", weight, mean)))


def closed_form_m(W: Matrix, random_m2: Array, iterations: int) -> float:
    """Error of x <- W x (1 - 1/(t+1)) + x̂/(t+1) when all see and nothing is lost, root mean square over robots.

    With e the error, s = t e obeys s <- W s + noise, so that e after T iterations is sum_k W^k noise_(T-1-k) / T and
    E|e_i|^2 = sum_k sum_j (W^k)_ij^2 tr R_j / T^2.
    """
    trace = np.trace(random_m2, axis1=1, axis2=2)
    power, total = np.eye(len(W)), np.zeros(len(W))
    for _ in range(iterations):
        total += power**2 @ trace
        power = W @ power
    return math.sqrt(total.mean()) / iterations


def central_track_m(world: MonteCarloWorld, dive: Dive, density: float, honest: slice = slice(None)) -> Array:
    """Kalman filter that has every sample at once: place and velocity after each round of samples, (T, 6).

    The line for a target that moves. Constant velocity, driven by white acceleration of spectral `density` in m^2/s^3;
    samples come once a second, the first from all robots that count. Systematic errors are taken for random ones: a
    track forgets.
    """
    weight = np.linalg.inv(world.random_m2 + world.systematic_m2)
    F = np.block([[np.eye(3), np.eye(3)], [np.zeros((3, 3)), np.eye(3)]])
    Q = density * np.kron([[1.0 / 3.0, 1.0 / 2.0], [1.0 / 2.0, 1.0]], np.eye(3))
    x, P = np.zeros(6), np.diag([1.0] * 3 + [0.1**2] * 3)  # anywhere, at up to 10 cm/s
    counted = _mask(len(world.camera_m), honest)
    x[:3] = dive.sample_m[0, counted].mean(axis=0)
    track = np.empty((len(dive.sees), 6))
    for k, (samples, sees) in enumerate(zip(dive.sample_m, dive.sees, strict=True)):
        if k > 0:
            x, P = F @ x, F @ P @ F.T + Q
        information = np.linalg.inv(P)
        vector, used = information @ x, sees & counted
        information[:3, :3] += weight[used].sum(axis=0)
        vector[:3] += np.einsum("nij,nj->i", weight[used], samples[used])
        P = np.linalg.inv(information)
        x = P @ vector
        track[k] = x
    return track


def _mask(robots: int, chosen: slice) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    mask = np.zeros(robots, dtype=bool)
    mask[chosen] = True
    return mask


# --- draws ---

# One world for all: cases differ in what they name, not in where robots happen to be. Of these draws it is an ordinary
# one: ten robots have a bound of 2.5 mm after one sample each (half of all worlds lie between 2.3 and 2.6), and a mean
# that ignores covariances pays 2.4 times the bound (2.4 to 2.7).
WORLD = 6
DENSITY = 4e-6  # m^2/s^3: acceleration that the filters expect of a moving target


class Score(NamedTuple):
    """One draw at one iteration. Means over the robots that count, in m^2 where squared."""

    square: float | None  # of the error; None: no robot has an estimate
    nees: float | None  # e' P^-1 e with the robot's own covariance: 3 when honest
    covered: float  # share of robots with an estimate
    central: float  # square error of the fusion that has everything
    bound: float  # the square that the latter has in the mean over all draws


def world_of(case: Case) -> MonteCarloWorld:
    """The one world, with as many robots as the case has."""
    return draw_world(case.robots, case.noise, case.systematic, np.random.default_rng(WORLD))


def score_draw(case: Case, seed: int, number: int) -> list[Score]:
    """One draw: its scores at case.at."""
    rng = np.random.default_rng((seed, number, 1))  # (6, 0) draws the very numbers that drew WORLD
    random = Random(f"{seed} {number}")
    world = world_of(case)
    if case.speed_mm_s:
        return [score_moving_target(case, world, rng, random)]
    dive = draw_dive(world, case.views, case.outlier_mm * 1e-3, case.at[-1], rng)
    rounds = case.ticks * case.says
    found = []
    for k, (t, _, swarm) in enumerate(message_rounds(case, world, dive, random), 1):
        if k % rounds == 0 and t in case.at:
            square = bound_m(world, dive.sees[:t].sum(axis=0), case.honest) ** 2
            found.append(score(swarm, TARGET_M, central_m(world, dive, t, case.honest), square, case.honest))
    return found


def score_moving_target(case: Case, world: MonteCarloWorld, rng: np.random.Generator, random: Random) -> Score:
    """Mean over all rounds of the second half, each against where the target is then. The central filter's error takes
    the place of the bound."""
    speed_m_s, seconds = case.speed_mm_s * 1e-3, case.at[-1]
    path_m = circle_m(speed_m_s, np.arange(seconds, dtype=np.float64))
    dive = draw_dive(world, case.views, case.outlier_mm * 1e-3, seconds, rng, path_m)
    track = central_track_m(world, dive, DENSITY, case.honest)
    scores = []
    for t, late_s, swarm in message_rounds(case, world, dive, random):
        if 2 * t > seconds:
            truth_m, state = circle_m(speed_m_s, np.array([t - 1 + late_s]))[0], track[t - 1]
            scores.append(score(swarm, truth_m, state[:3] + late_s * state[3:], None, case.honest))
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


def score(swarm: Swarm, truth_m: Array, central: Array, bound_m2: float | None, honest: slice) -> Score:
    """The swarm's posteriors now, and the central fusion `central` (3,), against the truth (3,), metres.

    bound_m2: None where the central error is the bound.
    """
    robots = swarm.robots[honest]
    known = [robot.posterior for robot in robots if robot.posterior is not None]
    central_m2 = float(np.sum((central - truth_m) ** 2))
    bound = central_m2 if bound_m2 is None else bound_m2
    if not known:
        return Score(None, None, 0.0, central_m2, bound)
    error = np.array([posterior.x_m for posterior in known]) - truth_m
    covariance = np.array([posterior.cov_m2 for posterior in known])[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    nees = np.einsum("ni,ni->n", error, np.linalg.solve(covariance, error[:, :, None])[:, :, 0])
    square = float(np.sum(error**2, axis=1).mean())
    return Score(square, float(nees.mean()), len(known) / len(robots), central_m2, bound)


def mean_score(scores: Sequence[Score]) -> Score:
    """The mean over rounds of one draw; what does not exist is left out."""

    def over(values: Sequence[float | None]) -> float | None:
        there = [value for value in values if value is not None]
        return math.fsum(there) / len(there) if there else None

    square, nees, covered, central, bound = (over(column) for column in zip(*scores, strict=True))
    return Score(square, nees, covered or 0.0, central or 0.0, bound or 0.0)
