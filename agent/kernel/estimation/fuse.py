"""Fuse what each robot says into one place: a vote finds those that agree, Huber's weights soften the rest.

One robot that is wrong must not move the others, and nobody knows beforehand which one it is. Two opinions agree when
their distance is likely under the sum of their covariances. The opinion consistent with most others leads; only these
enter the mean, and those of them that stand apart enter with less weight (Huber, Robust Statistics, 1981).
Covariances hold the systematic error of their robot, so no robot grows surer than its survey and calibration allow.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import accumulate
from typing import Literal, NamedTuple

from agent.kernel.estimation.matrix import ZERO, apply, distance2, invert, plus, quadratic, times, trace
from agent.kernel.messages import Symmetric, Vector

Verdict = Literal["none", "single", "ok", "ambiguous", "outlier"]

AGREE = 16.27  # chi^2, 3 degrees of freedom, 0.999: honest robots disagree once in a thousand pairs
HUBER = 1.5  # sigma; smaller attenuates small biases more, at 1 to 5 % of the accuracy when all are honest
ROUNDS = 10  # of reweighting
SETTLED = 1e-9  # change of a weight at which reweighting ends early
VOTERS = 64  # beyond this many the vote (pairs) costs more than a tick has; then who is consistent with the median


class Opinion(NamedTuple):
    """Where one robot places the target, by its own samples alone; world frame."""

    origin: str
    x_m: Vector
    cov_m2: Symmetric  # random part, shrunk by its samples, plus systematic part
    precision: Symmetric  # the inverse of that, 1/m^2


class Ballot(NamedTuple):
    """Outcome of a vote."""

    group: frozenset[str]  # the leader and who is consistent with it
    verdict: Verdict
    votes: dict[str, int]  # origins consistent with each, itself included


class Fused(NamedTuple):
    """The agreed place, and how it came about."""

    x_m: Vector
    cov_m2: Symmetric
    verdict: Verdict
    votes: dict[str, int]  # origins consistent with each, itself included
    factors: dict[str, float]  # Huber's weight of each origin; 0: left out
    shares: dict[str, float]  # of each origin in the mean, by trace of information; sum 1


def fuse(opinions: Sequence[Opinion], common_m2: Symmetric = ZERO) -> Fused | None:
    """Fuse opinions given in the order of their names; None without any.

    `common_m2`: covariance of errors that all robots share (tank frame, water), which no vote can see.
    """
    if not opinions:
        return None
    ballot = vote(opinions)
    agreeing = [opinion for opinion in opinions if opinion.origin in ballot.group]
    x, weights, information = _huber(agreeing)
    factors = {opinion.origin: w for opinion, w in zip(agreeing, weights, strict=True)}
    sizes = {opinion.origin: w * trace(opinion.precision) for opinion, w in zip(agreeing, weights, strict=True)}
    total = math.fsum(sizes.values())
    return Fused(
        x,
        plus(invert(information), common_m2),
        ballot.verdict,
        ballot.votes,
        {opinion.origin: factors.get(opinion.origin, 0.0) for opinion in opinions},
        {name: size / total for name, size in sizes.items()},
    )


def vote(opinions: Sequence[Opinion]) -> Ballot:
    """Who agrees with whom, of opinions given in the order of their names; at least one."""
    consistent = _consistent(opinions)
    leader = max(range(len(opinions)), key=lambda j: (_score([opinions[i] for i in consistent[j]]), -j))
    return Ballot(
        frozenset(opinions[j].origin for j in consistent[leader]),
        _verdict(len(consistent[leader]), len(opinions)),
        {opinion.origin: len(each) for opinion, each in zip(opinions, consistent, strict=True)},
    )


def _verdict(agreeing: int, all_: int) -> Verdict:
    if all_ == 1:
        return "single"
    if 2 * agreeing <= all_:
        return "ambiguous"
    return "ok" if agreeing == all_ else "outlier"


def _consistent(opinions: Sequence[Opinion]) -> list[list[int]]:
    """Indices of those that agree with each opinion, itself included, in order."""
    n = len(opinions)
    if n > VOTERS:
        median = _median(opinions)
        near = [j for j, o in enumerate(opinions) if quadratic(o.precision, _minus(o.x_m, median)) < AGREE]
        return [near if j in near else [j] for j in range(n)]
    consistent: list[list[int]] = [[j] for j in range(n)]
    for j in range(n):
        _, xj, pj, _ = opinions[j]
        for k in range(j):
            _, xk, pk, _ = opinions[k]
            if distance2(plus(pj, pk), _minus(xj, xk)) < AGREE:
                consistent[j].append(k)
                consistent[k].append(j)
    return [sorted(each) for each in consistent]


def _score(group: Sequence[Opinion]) -> tuple[int, float]:
    """The most numerous first; among equals, those that know more together."""
    return len(group), math.fsum(trace(opinion.precision) for opinion in group)


def _huber(opinions: Sequence[Opinion]) -> tuple[Vector, list[float], Symmetric]:
    """Reweighted mean: place, weight of each, and the sum of weighted information in 1/m^2."""
    weights = [1.0] * len(opinions)
    vectors = [apply(opinion.precision, opinion.x_m) for opinion in opinions]
    x, information = _mean(opinions, vectors, weights)
    for _ in range(ROUNDS):
        before = weights
        weights = [_weight(quadratic(opinion.precision, _minus(opinion.x_m, x))) for opinion in opinions]
        if max(abs(a - b) for a, b in zip(weights, before, strict=True)) < SETTLED:
            break
        x, information = _mean(opinions, vectors, weights)
    return x, weights, information


def _weight(d2: float) -> float:
    return 1.0 if d2 <= HUBER * HUBER else HUBER / math.sqrt(d2)


def _mean(opinions: Sequence[Opinion], vectors: Sequence[Vector], weights: Sequence[float]) -> tuple[Vector, Symmetric]:
    information, x, y, z = ZERO, 0.0, 0.0, 0.0
    for opinion, v, w in zip(opinions, vectors, weights, strict=True):
        information = plus(information, times(w, opinion.precision))
        x, y, z = x + w * v[0], y + w * v[1], z + w * v[2]
    return apply(invert(information), (x, y, z)), information


def _median(opinions: Sequence[Opinion]) -> Vector:
    """Weighted median of each coordinate, by the inverse trace of the covariance."""
    weights = [1.0 / trace(opinion.cov_m2) for opinion in opinions]
    half = 0.5 * math.fsum(weights)

    def along(axis: int) -> float:
        order = sorted((o.x_m[axis], w) for o, w in zip(opinions, weights, strict=True))
        passed = accumulate(weight for _, weight in order)
        return next(value for (value, _), sum_ in zip(order, passed, strict=True) if sum_ >= half)

    return along(0), along(1), along(2)


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]
