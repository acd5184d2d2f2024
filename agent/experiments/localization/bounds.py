"""What the best possible fusion would reach, and what the paper's update must reach: the lines to measure against.

Lengths are metres, covariances m^2; every root mean square is over the three axes together.
"""

from __future__ import annotations

import math

import numpy as np

from agent.experiments.localization.graphs import Matrix
from agent.experiments.localization.world import Array, Dive, MonteCarloWorld


def bound_m(world: MonteCarloWorld, samples: Array, honest: slice = slice(None)) -> float:
    """The Cramer-Rao bound with `samples` of each robot, (N,), from those `honest`.

    A robot's mean has covariance R / n + B, the systematic B undivided; unbiased fusion adds up their inverses.
    """
    counted = np.flatnonzero((samples > 0) & _mask(len(samples), honest))
    mean = world.random_m2[counted] / samples[counted, None, None] + world.systematic_m2[counted]
    return math.sqrt(np.trace(np.linalg.inv(np.linalg.inv(mean).sum(axis=0))))


def central_m(world: MonteCarloWorld, dive: Dive, iterations: int, honest: slice = slice(None)) -> Array:
    """The estimate (3,) of somebody who has every sample and every covariance: it meets the bound."""
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
    """Kalman filter of somebody who has every sample at once: place and velocity after each round of samples, (T, 6).

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
