"""What a robot would conclude from each of many lies: the kernel's rule (estimation/fuse.py) on columns of numbers.

A search asks for a hundred thousand conclusions a dive. Here one call takes all candidates at once; a test holds the
outcome against the kernel's, to the nanometre.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from agent.core.estimation.fuse import AGREE, DOUBTED, HIGH, LOW, PAIRS, TEMPER
from agent.experiments.localization.world import Array

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
    """m times what n robots say, and who of them entered, (m, n) of 0 and 1."""

    x: Array  # (m, n, 3)
    P: Array  # (m, n, 3, 3)
    precision: Array
    vector: Array  # P^-1 x
    inside: Array

    @property
    def total(self) -> Array:
        """Information of those who entered, (m, 3, 3)."""
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
    """The mean over the ways to leave some out, (m, 3); all_m: where everybody is heard."""
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
        rest = inverse(total - gone + 1e-12 * np.eye(3))  # nobody may be left
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
