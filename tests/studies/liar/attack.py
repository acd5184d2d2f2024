"""A dive in which robots tell the best lies that can be found: how far the honest are moved from where they would be.

The same fleet dives twice, with the same samples and the same losses. In one dive the liars see nothing and only pass
on what they hear; in the other they say, from the 20th iteration to the 40th, whatever moves the honest most, found
anew in every iteration by a search that knows every honest opinion, and forge an entry of every other robot in every
message. How far apart the two fleets believe the target to be is the liars' doing.
"""

import math
from collections.abc import Sequence
from random import Random
from typing import Literal, NamedTuple

import numpy as np
from msgspec.structs import replace

from agent.core.config import Protocol, Tank
from agent.core.estimation.evidence_table import MARGIN_M, R_FLOOR_M
from agent.core.estimation.interface import Update
from agent.core.linear_algebra import apply, upper
from agent.core.messages import Entry, Estimate, Symmetric, Vector
from agent.experiments.localization.draws import WORLD
from agent.experiments.localization.lockstep import (
    TARGET_M,
    Array,
    Swarm,
    Topology,
    draw_dive,
    draw_world,
    graph,
    prior,
    symmetric,
)
from tests.studies.liar.search import CLAIM_M, Lies, best_lies, bound_m, conclusions

Then = Literal["honest", "no key"]


class LiarCase(NamedTuple):
    """Robots 0 to `liars` - 1 lie for 20 iterations. `then`: they start again and tell the truth, or lose their key."""

    topology: Topology
    robots: int
    liars: int = 1
    protocol: Protocol = "evidence"
    keys: bool = True  # `evidence` is signed by its origin
    clip: bool = False
    loss: float = 0.1
    then: Then = "honest"
    speed_mm_s: float = 0.0  # of the target
    scale: float = 0.0  # by which share all ranges may be long, as the fleet's budget has it
    bumped_mm: float = 0.0  # no lie: robot 0 is wrong by this much for 40 iterations, then repaired


FIRST, LAST = 20, 40  # iterations of lies, the latter excluded
AFTER = 10  # iterations that go on
GROWTH = 1.1  # of the information that a liar claims, in an iteration: what is added must lie in the tank
FORGED = 5000  # samples that a forged entry claims: more than any robot has, and no more than one may have
FAR_M = (0.3, 0.3, 0.07)  # where they all place the target in a fleet without keys


class Outcome(NamedTuple):
    """One draw. Largest distance of the two beliefs of any honest robot, in metres."""

    moved_m: float  # at any iteration of the lie
    ratio: float | None  # of it to the bound at that iteration, the largest; None: no bound is known
    end_m: float  # at the last iteration of the lie
    after_m: tuple[float, ...]  # at each iteration after it
    share: float | None = None  # of robot 0 in the mean, over that of one that was never bumped


def attacked(case: LiarCase, seed: int) -> Outcome:
    """One draw of a target at rest."""
    world = draw_world(case.robots, "aniso", True, np.random.default_rng(WORLD))
    lever_m = TARGET_M - world.camera_m
    stretched = case.scale**2 * np.einsum("ni,nj->nij", lever_m, lever_m)
    world = world._replace(systematic_m2=world.systematic_m2 + stretched)  # as an opinion has it
    rng, iterations = chance(seed), LAST + AFTER
    dive = draw_dive(world, "all", 0.0, iterations, rng)
    clear, lied = (fleet_of(case, Random(seed)) for _ in range(2))
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


def chance(seed: int) -> np.random.Generator:
    """Of a draw; another one than that which drew the world."""
    return np.random.default_rng((seed, 1))


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
            else:
                swarm.distrust(i)


def outcome(moved: Sequence[float], bounds: Sequence[float | None]) -> Outcome:
    """moved: one number for each iteration; bounds: for each iteration of the lie."""
    during = moved[FIRST:LAST]
    ratios = [d / bound for d, bound in zip(during, bounds, strict=True) if bound is not None]
    return Outcome(max(during), max(ratios, default=None), during[-1], tuple(moved[LAST:]))


def apart_m(one: Swarm, other: Swarm, robots: range) -> float:
    """How far two fleets believe the target to be apart, the largest over robots; metres."""
    pairs = ((one.robots[i].posterior, other.robots[i].posterior) for i in robots)
    return max((math.dist(a.x_m, b.x_m) for a, b in pairs if a is not None and b is not None), default=0.0)


def unchanged(i: int, estimate: Estimate) -> Estimate:
    """What an honest robot says."""
    return estimate


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


# --- a robot that is knocked, wrong for a while without knowing it, then repaired: is it believed? ---


def bumped(case: LiarCase, seed: int) -> Outcome:
    """One draw, beside the same fleet in which no robot was knocked.

    `share` is the weight of robot 0 in what the others conclude at the end, over its weight in that other fleet.
    """
    world = draw_world(case.robots, "aniso", True, np.random.default_rng(WORLD))
    rng, iterations = chance(seed), LAST + AFTER
    dive = draw_dive(world, "all", 0.0, iterations, rng)
    angle = rng.uniform(0.0, 2.0 * math.pi)
    knock_m = case.bumped_mm * 1e-3 * np.array([math.cos(angle), math.sin(angle), 0.0])
    sound, knocked = (fleet_of(case, Random(seed)) for _ in range(2))
    own, fixed = symmetric(world.random_m2), symmetric(world.systematic_m2)
    moved, shares = [], (0.0, 0.0)
    for k in range(iterations):
        if k == LAST:
            knocked.restart(0)
        priors = [prior(dive.sample_m[k, i], own[i], fixed[i], sound.now_ns) for i in range(case.robots)]
        wrong = prior(dive.sample_m[k, 0] + knock_m * (k < LAST), own[0], fixed[0], sound.now_ns)
        shares = share(sound.tick(priors)), share(knocked.tick([wrong, *priors[1:]]))
        sound.speak()
        knocked.speak()
        moved.append(apart_m(sound, knocked, range(1, case.robots)))
    return outcome(moved, [None] * (LAST - FIRST))._replace(share=shares[1] / shares[0])


def share(updates: list[Update]) -> float:
    """Weight of robot 0 in the conclusions of the others, the mean."""
    weights = [update.explain.weights.get("r0", 0.0) for update in updates[1:]]
    return math.fsum(weights) / len(weights)
