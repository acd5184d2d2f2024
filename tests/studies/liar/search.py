"""The best lie: a search where every honest opinion is known, against the kernel's rule on columns of numbers.

Lies that were chosen prove nothing: a rule that shrugs off 300 mm may be moved 50 mm by 15. So the liar looks for what
moves the others most, by the cross-entropy method (Rubinstein, 1999): draw candidates, keep the best, draw again where
they are. A better search can take the place of `best_lies`.
"""

import math
from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from agent.core.estimation.fuse import AGREE, DOUBTED, HIGH, LOW, PAIRS, TEMPER
from agent.experiments.localization.lockstep import Array

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


# --- what a robot concludes from each of many lies: the kernel's rule (estimation.fuse) on columns of numbers ---
# A search asks for a hundred thousand conclusions a dive. Here one call takes all candidates at once; a test holds
# the outcome against the kernel's, to the nanometre.

TIED = 1e6  # a member more counts for more than any sum of distances within a group


def conclusions(honest_m: Array, honest_m2: Array, lies_m: Array, lies_m2: Array, liars: int = 1) -> Array:
    """Fuse the honest opinions, (n, 3) and (n, 3, 3), with each candidate of lies: (m, k, 3) -> places (m, 3).

    Lies (m, k, 3) with covariances (m, k, 3, 3): k robots lie, and come before the honest ones in the order of names.
    liars: how many the robots reckon with.
    """
    m, k = lies_m.shape[:2]
    n = k + len(honest_m)
    x = np.concatenate([lies_m, np.broadcast_to(honest_m, (m, *honest_m.shape))], axis=1)
    P = np.concatenate([lies_m2, np.broadcast_to(honest_m2, (m, *honest_m2.shape))], axis=1)
    known = np.broadcast_to(inverse(honest_m2), (m, n - k, 3, 3))
    precision = np.concatenate([inverse(lies_m2), known], axis=1)
    said = Said(x, P, precision, np.einsum("mjab,mjb->mja", precision, x), group(x, P, k))
    everybody = np.einsum("mab,mb->ma", inverse(said.total), said.sums)
    size = said.inside.sum(axis=1)
    outcome = without(said, [(j,) for j in range(n)], everybody)
    if liars > 1:
        enough = (size >= PAIRS[0]) & (size <= PAIRS[1])
        outcome = np.where(enough[:, None], without(said, list(combinations(range(n), 2)), everybody), outcome)
    return np.asarray(np.where((size >= DOUBTED)[:, None], outcome, everybody))


class Said(NamedTuple):
    """m times what n robots say, and which of them entered, (m, n) of 0 and 1."""

    x: Array  # (m, n, 3)
    P: Array  # (m, n, 3, 3)
    precision: Array
    vector: Array  # P^-1 x
    inside: Array

    @property
    def total(self) -> Array:
        """Information of those that entered, (m, 3, 3)."""
        return np.asarray(np.einsum("mj,mjab->mab", self.inside, self.precision))

    @property
    def sums(self) -> Array:
        return np.asarray(np.einsum("mj,mja->ma", self.inside, self.vector))


def group(x: Array, P: Array, lies: int) -> Array:
    """Who enters, (m, n) of 0 and 1: the largest set that agrees with one of its members, the closest of equals.

    The first `lies` differ from row to row, the others do not.
    """
    m, n = x.shape[:2]
    d2 = np.empty((m, n, n))
    d2[:, lies:, lies:] = distance2(P[0, lies:, None] + P[0, lies:], x[0, lies:, None] - x[0, lies:])
    d2[:, :lies] = distance2(P[:, :lies, None] + P[:, None], x[:, :lies, None] - x[:, None])
    d2[:, lies:, :lies] = np.swapaxes(d2[:, :lies, lies:], 1, 2)
    near = (d2 < AGREE).astype(float)
    spread = ((near @ d2) * near).sum(axis=2)
    leader = np.argmax(TIED * near.sum(axis=2) - spread - 1e-9 * np.arange(n), axis=1)
    return np.asarray(near[np.arange(m), leader])


def without(said: Said, ways: Sequence[tuple[int, ...]], all_m: Array) -> Array:
    """The mean over the ways to leave some out, (m, 3); all_m: where all are heard."""
    x, P, precision, vector, inside = said
    total, sums, places, falls = said.total, said.sums, [], []
    for out in ways:
        j, *others = out
        gone, lost = inside[:, j, None, None] * precision[:, j], inside[:, j, None] * vector[:, j]
        apart, cov, there = np.zeros(len(x)), P[:, j], x[:, j]
        for k in others:
            apart = distance2(P[:, j] + P[:, k], x[:, j] - x[:, k])
            gone, lost = gone + inside[:, k, None, None] * precision[:, k], lost + inside[:, k, None] * vector[:, k]
            cov = inverse(precision[:, j] + precision[:, k])
            there = np.einsum("mab,mb->ma", cov, vector[:, j] + vector[:, k])
        rest = inverse(total - gone + 1e-12 * np.eye(3))  # none may be left
        place = np.einsum("mab,mb->ma", rest, sums - lost)
        member = np.all(inside[:, list(out)] > 0.0, axis=1)
        places.append(place)
        falls.append(np.where(member, apart + distance2(cov + rest, there - place), -np.inf))
    d2 = np.stack(falls, axis=1)
    largest = d2.max(axis=1)
    scale = np.sqrt(len(ways[0]))
    strength = np.clip((np.sqrt(np.maximum(largest, 0.0)) / scale - LOW) / (HIGH - LOW), 0.0, 1.0)
    odds = np.exp(-0.5 * TEMPER * (np.where(np.isfinite(largest), largest, 0.0)[:, None] - d2))
    odds /= np.maximum(odds.sum(axis=1, keepdims=True), 1e-300)
    mean = np.einsum("mw,mwa->ma", odds, np.stack(places, axis=1))
    return np.asarray(all_m + strength[:, None] * (mean - all_m))


def distance2(P: Array, d: Array) -> Array:
    """d^T P^-1 d over leading axes: (..., 3, 3) and (..., 3)."""
    return np.asarray(np.einsum("...a,...ab,...b->...", d, inverse(P), d))


def inverse(a: Array) -> Array:
    """Inverses of symmetric (..., 3, 3), by cofactors: ten times as fast as a factorisation of each."""
    xx, xy, xz, yy, yz, zz = a[..., 0, 0], a[..., 0, 1], a[..., 0, 2], a[..., 1, 1], a[..., 1, 2], a[..., 2, 2]
    c00, c01, c02 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    c11, c12, c22 = xx * zz - xz * xz, xy * xz - xx * yz, xx * yy - xy * xy
    flat = (
        np.stack([c00, c01, c02, c01, c11, c12, c02, c12, c22], axis=-1) / (xx * c00 + xy * c01 + xz * c02)[..., None]
    )
    return np.asarray(flat.reshape(a.shape))


# --- how far any single lie can go ---

SLACK = 1.16  # what a lie may do beyond a bound that is exact to second order only: the largest of 800 lies of 1.16


def bound_m(x_m: Array, cov_m2: Array) -> float:
    """Beyond which no single lie moves honest opinions (n, 3) with covariances (n, 3, 3).

    Up to LOW no robot is in doubt, and one that stands d from the others moves them by at most d sigma. Beyond it a
    liar needs an honest robot that stands as far out as itself, h_j, from whose absence s_j the others know the place.
    """
    found = [LOW * spread_m(np.linalg.inv(np.linalg.inv(cov_m2).sum(axis=0)))]
    for j in range(len(x_m)) if len(x_m) > 1 else ():
        others = np.delete(np.arange(len(x_m)), j)
        precision = np.linalg.inv(cov_m2[others])
        without_m2 = np.linalg.inv(precision.sum(axis=0))
        gap = x_m[j] - without_m2 @ np.einsum("nij,nj->i", precision, x_m[others])
        found.append(math.sqrt(gap @ np.linalg.solve(cov_m2[j] + without_m2, gap)) * spread_m(without_m2))
    return SLACK * max(found)


def spread_m(cov_m2: Array) -> float:
    """Standard deviation along the worst direction."""
    return math.sqrt(float(np.linalg.eigvalsh(cov_m2)[-1]))
