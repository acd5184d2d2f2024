"""A dive in which robots tell the best lies that can be found: how far the honest are moved from where they would be.

The same fleet dives twice, with the same samples and the same losses. In one dive the liars see nothing and only pass
on what they hear; in the other they say, from the 20th iteration to the 40th, whatever moves the honest most, found
anew in every iteration by a search that knows every honest opinion (`best_lies`), and forge an entry of every other
robot in every message. How far apart the two fleets believe the target to be is the liars' doing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import combinations
from random import Random
from typing import Literal, NamedTuple

import numpy as np
from msgspec.structs import replace

from agent.core.config import Protocol, Tank
from agent.core.estimation.evidence_table import MARGIN_M, R_FLOOR_M
from agent.core.estimation.fuse import AGREE, DOUBTED, HIGH, LOW, PAIRS, TEMPER
from agent.core.linear_algebra import apply, upper
from agent.core.messages import Entry, Estimate, Symmetric, Vector
from agent.experiments.experiment import Row
from agent.experiments.localization.draws import MORE, QUICK, WORLD
from agent.experiments.localization.lockstep import (
    Array,
    Swarm,
    Topology,
    draw_dive,
    draw_world,
    graph,
    prior,
    symmetric,
)

# --- cases: one list, in the order of the table ---

Then = Literal["silent", "honest", "no key"]


class LiarCase(NamedTuple):
    """Robots 0 to `liars` - 1 lie for 20 iterations. `then`: what becomes of them after it."""

    topology: Topology
    robots: int
    draws: int
    liars: int = 1
    protocol: Protocol = "evidence"
    keys: bool = True  # `evidence` is signed by its origin
    clip: bool = False
    loss: float = 0.1
    then: Then = "silent"
    speed_mm_s: float = 0.0  # of the target
    bumped_mm: float = 0.0  # no lie: robot 0 is wrong by this much for 40 iterations, then repaired

    def named(self) -> Row:
        """What a row of result.json says of its case."""
        return self._asdict()


def liar_cases(quick: bool = False, full: bool = False) -> list[LiarCase]:
    """Fifteen minutes of processor time, most of it for ten robots."""
    found = [*at_rest(), *without_keys(), *afterwards(), *moving(), *two(), *bumped(), *averaging()]
    if quick:
        return [
            case._replace(draws=max(2, case.draws // QUICK))
            for case in found
            if not (case.robots > 5 and case.speed_mm_s)
        ]
    return [case._replace(draws=case.draws * MORE) if full else case for case in found]


def at_rest() -> list[LiarCase]:
    """All hear all; then graphs on which a lie has to be passed on."""
    meshes = [LiarCase("full", robots, 100) for robots in (3, 5, 10)]
    return [*meshes, LiarCase("geometric", 10, 20), LiarCase("line", 5, 40)]


def without_keys() -> list[LiarCase]:
    """A robot's own word counts where it is heard directly; where it is not, nothing stops a relay that changes it."""
    return [LiarCase("full", 3, 40, keys=False), LiarCase("geometric", 10, 10, keys=False)]


def afterwards() -> list[LiarCase]:
    """It starts again and tells the truth, or its key is taken away."""
    honest = [LiarCase("full", robots, draws, then="honest") for robots, draws in ((3, 40), (5, 40), (10, 20))]
    return [*honest, *(LiarCase("full", robots, 20, then="no key") for robots in (3, 5))]


def moving() -> list[LiarCase]:
    """The target swims, and every lie binds the next."""
    return [LiarCase("full", robots, draws, speed_mm_s=20.0) for robots, draws in ((3, 20), (5, 10), (10, 4))]


def two() -> list[LiarCase]:
    """Two of ten agree on their lies, and the fleet file reckons with two."""
    return [LiarCase("full", 10, 10, liars=2)]


def bumped() -> list[LiarCase]:
    """One of three is knocked, for forty iterations no robot notices, then it is repaired and starts again."""
    return [LiarCase("full", 3, 40, bumped_mm=mm) for mm in (30.0, 100.0, 300.0)]


def averaging() -> list[LiarCase]:
    """What the protocols that average beliefs have: a word from the far corner of the tank."""
    swarms = (3, 5, 10)
    found = [LiarCase("full", robots, 40, protocol="paper") for robots in swarms]
    found += [
        LiarCase("full", robots, 40, protocol="metropolis", clip=clip) for clip in (False, True) for robots in swarms
    ]
    return found


# --- search: the best lie, over place and covariance, where every honest opinion is known ---
# Lies that were chosen prove nothing: a rule that shrugs off 300 mm may be moved 50 mm by 15. So the liar looks for
# what moves the others most, by the cross-entropy method (Rubinstein, 1999): draw candidates, keep the best, draw again
# where they are. A better search can take the place of `best_lies`.

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


# --- the attack on a target at rest ---

FIRST, LAST = 20, 40  # iterations of lies, the latter excluded
AFTER = 10  # iterations that go on
SLACK = 1.16  # what a lie may do beyond a bound that is exact to second order only: the largest of 800 lies of 1.16
GROWTH = 1.1  # of the information that a liar claims, in an iteration: what is added must lie in the tank
FORGED = 5000  # samples that a forged entry claims: more than any robot has, and no more than one may have
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
    """A fleet as the case wants it, without any lie yet."""
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
