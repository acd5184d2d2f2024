"""The best lie that can be told: a search over place and covariance by somebody who knows every honest opinion.

Lies that were chosen prove nothing: a rule that shrugs off 300 mm may be moved 50 mm by 15. So the liar looks for what
moves the others most, by the cross-entropy method (Rubinstein, 1999): draw candidates, keep the best, draw again where
they are. Anyone who thinks that a better lie exists can put a search of his own in the place of `best_lies`.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agent.experiments.localization.world import Array

Gain = Callable[[Array, Array], Array]  # lies (m, k, 3) and their covariances (m, k, 3, 3) -> metres moved (m,)

PARAMETERS = 9  # place, logarithms of the diagonal of a Cholesky factor, what is below it over the diagonal
START = np.array([0.0] * 9)
SPREAD = np.array([4.0, 4.0, 4.0, 1.5, 1.5, 1.5, 1.0, 1.0, 1.0])
CLAIM_M = 0.0001  # sigma below which no lie goes: surer ones gain less than a hundredth
CHAINS = 4  # searches side by side: the best lie is often one of several far apart
SAMPLES = 48  # candidates of each, in each generation
ELITE = 8
GENERATIONS = 14
AGAIN = (2, 8)  # chains and generations where the best lie of a moment ago is known
KEEP = 0.3  # share of the old distribution in the new
LEAST = 0.02  # spread that is always left


class Lies(NamedTuple):
    """What k liars say, and what they hope to move."""

    x_m: Array  # (k, 3)
    cov_m2: Array  # (k, 3, 3)
    moves_m: float
    parameters: Array  # (k * 9,), to go on from when the honest know more


def best_lies(
    gain: Gain,
    centre_m: Array,
    root_m: Array,
    liars: int,
    rng: np.random.Generator,
    last: Lies | None = None,
    effort: float = 1.0,
) -> Lies:
    """Search where honest opinions have their mean, (3,), in units of a root of its covariance, (3, 3).

    last: the lies before, near which one search begins. effort: times as many candidates.
    """
    samples = round(SAMPLES * effort)
    chains, generations = (CHAINS, GENERATIONS) if last is None else AGAIN
    mean = np.tile(np.tile(START, liars), (chains, 1))
    spread = np.tile(np.tile(SPREAD, liars), (chains, 1))
    if last is not None:
        mean[0], spread[0] = last.parameters, 0.2 * spread[0]
    best, moved = mean[0], -1.0
    for _ in range(generations):
        drawn = mean[:, None] + spread[:, None] * rng.standard_normal((chains, samples, mean.shape[1]))
        flat = drawn.reshape(-1, mean.shape[1])
        values = gain(*spoken(flat, centre_m, root_m)).reshape(chains, samples)
        order = np.argsort(-values, axis=1)[:, :ELITE]
        elite = np.take_along_axis(drawn, order[:, :, None], axis=1)
        mean = KEEP * mean + (1.0 - KEEP) * elite.mean(axis=1)
        spread = np.maximum(KEEP * spread + (1.0 - KEEP) * elite.std(axis=1), LEAST)
        top = int(np.argmax(values))
        if values.flat[top] > moved:
            best, moved = flat[top], float(values.flat[top])
    x_m, cov_m2 = spoken(best[None], centre_m, root_m)
    return Lies(x_m[0], cov_m2[0], moved, best)


def spoken(parameters: Array, centre_m: Array, root_m: Array) -> tuple[Array, Array]:
    """Parameters (m, k * 9) -> places (m, k, 3) and covariances (m, k, 3, 3), none below CLAIM_M."""
    each = parameters.reshape(len(parameters), -1, PARAMETERS)
    x_m = centre_m + each[..., :3] @ root_m.T
    size = float(np.sqrt(np.trace(root_m @ root_m.T) / 3.0))
    diagonal = size * np.exp(np.clip(each[..., 3:6], -8.0, 5.0))
    L = np.zeros((*each.shape[:2], 3, 3))
    L[..., [0, 1, 2], [0, 1, 2]] = diagonal
    L[..., [1, 2, 2], [0, 0, 1]] = each[..., 6:9] * diagonal[..., [0, 0, 1]]
    return x_m, L @ np.swapaxes(L, -1, -2) + CLAIM_M**2 * np.eye(3)
