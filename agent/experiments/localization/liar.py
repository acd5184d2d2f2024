"""A dive in which robots lie as well as anybody can: how far the honest are moved from where they would be.

The same fleet dives twice, with the same samples and the same losses. In one dive the liars see nothing and only pass
on what they hear; in the other they say, from the 20th iteration to the 40th, whatever moves the honest most, found
anew in every iteration by somebody who knows every honest opinion (lie_search.py), and forge an entry of every other
robot in every message. How far apart the two fleets believe the target to be is the liars' doing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from random import Random
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace

from agent.core.config import Tank
from agent.core.estimation.evidence_table import MARGIN_M, R_FLOOR_M
from agent.core.estimation.fuse import LOW
from agent.core.linear_algebra import apply, upper
from agent.core.messages import Entry, Estimate, Symmetric, Vector
from agent.experiments.localization.draws import WORLD
from agent.experiments.localization.graphs import graph
from agent.experiments.localization.liar_cases import LiarCase
from agent.experiments.localization.lie_search import CLAIM_M, Lies, best_lies
from agent.experiments.localization.lockstep import Swarm, prior, symmetric
from agent.experiments.localization.many_lies import conclusions
from agent.experiments.localization.world import Array, draw_dive, draw_world

FIRST, LAST = 20, 40  # iterations of lies, the latter excluded
AFTER = 10  # iterations that go on
SLACK = 1.16  # what a lie may do beyond a bound that is exact to second order only: the largest of 800 lies of 1.16
GROWTH = 1.1  # of the information that a liar claims, in an iteration: what is added must lie in the tank
FORGED = 5000  # samples that a forged entry claims: more than anybody has, and no more than a robot may have
FAR_M = (0.3, 0.3, 0.07)  # where they all place the target in a fleet without keys


class Outcome(NamedTuple):
    """One draw. Largest distance of the two beliefs of any honest robot, in metres."""

    moved_m: float  # at any iteration of the lie
    ratio: float | None  # of it to the bound at that iteration, the largest; None: no bound is known
    bound_m: float | None  # at the last iteration of the lie
    end_m: float  # at the last iteration of the lie
    after_m: tuple[float, ...]  # at each iteration after it
    share: float | None = None  # of robot 0 in the mean, over that of one that was never bumped


def attacked(case: LiarCase, seed: int, number: int) -> Outcome:
    """One draw of a target at rest."""
    world = draw_world(case.robots, "aniso", True, np.random.default_rng(WORLD))
    rng, iterations = np.random.default_rng((seed, number)), LAST + AFTER
    dive = draw_dive(world, "all", 0.0, iterations, rng)
    clear, lied = (fleet_of(case, Random(f"{seed} {number}")) for _ in range(2))
    own, fixed = symmetric(world.random_m2), symmetric(world.systematic_m2)
    speech, honest = Speech(case), range(case.liars, case.robots)
    moved, bounds = [], []
    for k in range(iterations):
        if k == LAST:
            end(case, clear, lied)
        truthful = case.then == "honest" and k >= LAST
        for swarm in (clear, lied):
            swarm.tick(
                [
                    prior(dive.sample_m[k, i], own[i], fixed[i], swarm.now_ns) if truthful or i in honest else None
                    for i in range(case.robots)
                ]
            )
        if FIRST <= k < LAST:
            x_m = dive.sample_m[: k + 1].mean(axis=0)[case.liars :]
            cov_m2 = (world.random_m2 / (k + 1) + world.systematic_m2)[case.liars :]
            speech.prepare(x_m, cov_m2, rng)
            bounds.append(bound_m(x_m, cov_m2) if case.protocol == "evidence" and case.liars == 1 else None)
            lied.tamper = speech.said
        else:
            lied.tamper = unchanged
        clear.speak()
        lied.speak()
        moved.append(apart_m(clear, lied, honest))
    return outcome(moved, bounds)


def fleet_of(case: LiarCase, random: Random) -> Swarm:
    """A fleet as the case wants it, nobody lying yet."""
    signed = case.protocol == "evidence" and case.keys
    near = graph(case.topology, case.robots)
    return Swarm(case.protocol, near, case.loss, random, liars=case.liars, clip=case.clip, signed=signed)


def end(case: LiarCase, clear: Swarm, lied: Swarm) -> None:
    """The lie is over; what has to happen to both fleets."""
    for i in range(case.liars):
        for swarm in (clear, lied):
            if case.then == "honest":
                swarm.restart(i)
            elif case.then == "no key":
                swarm.distrust(i)


def outcome(moved: Sequence[float], bounds: Sequence[float | None]) -> Outcome:
    """moved: one number for each iteration; bounds: for each iteration of the lie."""
    during = moved[FIRST:LAST]
    ratios = [d / bound for d, bound in zip(during, bounds, strict=True) if bound is not None]
    return Outcome(max(during), max(ratios, default=None), bounds[-1], during[-1], tuple(moved[LAST:]))


def apart_m(one: Swarm, other: Swarm, robots: range) -> float:
    """How far two fleets believe the target to be apart, the largest over robots; metres."""
    pairs = ((one.robots[i].posterior, other.robots[i].posterior) for i in robots)
    return max((math.dist(a.x_m, b.x_m) for a, b in pairs if a is not None and b is not None), default=0.0)


def unchanged(i: int, estimate: Estimate) -> Estimate:
    """What an honest robot says."""
    return estimate


def bound_m(x_m: Array, cov_m2: Array) -> float:
    """Beyond which no single lie moves honest opinions (n, 3) with covariances (n, 3, 3).

    Up to LOW nobody is in doubt, and who stands d from the others moves them by at most d sigma. Beyond it a liar needs
    an honest robot that stands as far out as itself, h_j, from whose absence s_j the others know the place.
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


class Speech:
    """What liars say at rest."""

    def __init__(self, case: LiarCase) -> None:
        self._case = case
        self._lies: Lies | None = None
        self._entries: list[Entry] = []
        self._far_m: Vector = (*Tank().size_m[:2], 0.07)

    def prepare(self, honest_m: Array, honest_m2: Array, rng: np.random.Generator) -> None:
        """Find the lies of this iteration against honest opinions (n, 3) and (n, 3, 3)."""
        if self._case.protocol != "evidence":
            return
        precision = np.linalg.inv(honest_m2)
        centre_m2 = np.linalg.inv(precision.sum(axis=0))
        centre_m = centre_m2 @ np.einsum("nij,nj->i", precision, honest_m)
        nobody = np.zeros((1, 0, 3)), np.zeros((1, 0, 3, 3))
        alone_m = conclusions(honest_m, honest_m2, *nobody, self._case.liars)

        def gain(x_m: Array, cov_m2: Array) -> Array:
            there_m = conclusions(honest_m, honest_m2, x_m, cov_m2, self._case.liars)
            return np.asarray(np.linalg.norm(there_m - alone_m, axis=1))

        root_m = np.linalg.cholesky(centre_m2)
        self._lies = best_lies(gain, centre_m, root_m, self._case.liars, rng, self._lies)
        before: list[Entry | None] = [*self._entries] or [None] * self._case.liars
        self._entries = [
            told(f"r{i}", tuple(self._lies.x_m[i].tolist()), upper(self._lies.cov_m2[i]), before[i])
            for i in range(self._case.liars)
        ]

    def said(self, i: int, estimate: Estimate) -> Estimate:
        """What robot i says instead of `estimate`."""
        if i >= self._case.liars:
            return estimate
        if estimate.gossip is None:
            return replace(estimate, valid=True, x_m=self._far_m, cov_m2=(1e-6, 0.0, 0.0, 1e-6, 0.0, 1e-6))
        mine = self._entries[i]
        other = mine if self._case.keys else replace(mine, vector=apply(mine.information, FAR_M))
        forged = [
            replace(other, origin=f"r{j}", count=FORGED, signature=bytes(64))
            for j in range(self._case.robots)
            if j >= self._case.liars
        ]
        gossip = replace(estimate.gossip, entries=(mine, *forged, *estimate.gossip.entries))
        return replace(estimate, valid=True, gossip=gossip)


def told(origin: str, x_m: Vector, cov_m2: Symmetric, before: Entry | None) -> Entry:
    """An entry that says x, P and passes every check.

    What its samples say can only grow. So it claims many that know the place to CLAIM_M, and states as systematic what
    the lie wants beyond that, which may change at will.
    """
    level = CLAIM_M**-2 if before is None else before.information[0] * GROWTH
    information = (level, 0.0, 0.0, level, 0.0, level)
    sigma2 = 1.0 / level
    xx, xy, xz, yy, yz, zz = cov_m2
    low, high = -MARGIN_M, tuple(size + MARGIN_M for size in Tank().size_m)
    x, y, z = (min(max(place, low), top) for place, top in zip(x_m, high, strict=True))
    count = math.ceil(level * R_FLOOR_M**2) + 1
    count = count if before is None else max(count, before.count + 1)
    systematic = (xx - sigma2, xy, xz, yy - sigma2, yz, zz - sigma2)
    return Entry(origin, 0, count, information, apply(information, (x, y, z)), systematic)
