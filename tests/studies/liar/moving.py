"""What attack.py does to a target at rest, against tracks of one that moves.

A liar's opinion is the track through its samples, so what it says now binds what it can say next. It looks one
iteration ahead: the newest sample, or up to 16 of one moment that claim to know more, is the one that moves the honest
most, found against the kernel's own filters, vote and doubt.
"""

import math
from random import Random

import numpy as np
from msgspec.structs import replace

from agent.core.estimation.evidence_table import R_FLOOR_M
from agent.core.estimation.fuse import Opinion, distances2, doubts, mixture, vote
from agent.core.estimation.moving_target import WINDOW
from agent.core.estimation.track import FixedLagFilter, Held, Track, begin, correct, predict
from agent.core.linear_algebra import apply, inverse, invert, times, trace, upper
from agent.core.messages import Estimate, Sample, Symmetric, Vector
from agent.experiments.localization.draws import WORLD
from agent.experiments.localization.lockstep import Array, circle_m, draw_dive, draw_world, prior, symmetric
from tests.studies.liar.attack import (
    AFTER,
    FIRST,
    LAST,
    LiarCase,
    Outcome,
    apart_m,
    chance,
    fleet_of,
    outcome,
    unchanged,
)
from tests.studies.liar.search import Lies, best_lies, bound_m

COPIES = 16  # samples of one moment, at most
EFFORT = 0.5  # of the search at rest: each candidate costs a filter's step for each robot


def attacked_moving(case: LiarCase, seed: int) -> Outcome:
    """One draw of a target on a circle; robot 0 lies."""
    world = draw_world(case.robots, "aniso", True, np.random.default_rng(WORLD))
    rng, iterations = chance(seed), LAST + AFTER
    path_m = circle_m(case.speed_mm_s * 1e-3, np.arange(iterations, dtype=np.float64))
    dive = draw_dive(world, "all", 0.0, iterations, rng, path_m)
    clear, lied = (fleet_of(case, Random(seed)) for _ in range(2))
    own, fixed = symmetric(world.random_m2), symmetric(world.systematic_m2)
    information = [invert(upper(cov_m2)) for cov_m2 in world.random_m2 + world.systematic_m2]
    speech = MovingSpeech(case.robots)
    moved, bounds = [], []
    for k in range(iterations):
        now_ns = lied.now_ns
        priors = [prior(dive.sample_m[k, i], own[i], fixed[i], now_ns) for i in range(case.robots)]
        for swarm in (clear, lied):
            swarm.tick([None, *priors[1:]])
        speech.honest(now_ns, [(information[i], priors[i].x_m) for i in range(1, case.robots)])
        lied.tamper = unchanged
        if FIRST <= k < LAST:
            bounds.append(speech.prepare(now_ns, rng))
            lied.tamper = speech.said
        clear.speak()
        lied.speak()
        moved.append(apart_m(clear, lied, range(1, case.robots)))
    return outcome(moved, bounds)


class MovingSpeech:
    """What the liar knows and says."""

    def __init__(self, robots: int) -> None:
        self._held: list[list[Held]] = [[] for _ in range(robots)]  # of each robot; the liar's are its lies
        self._samples: list[Sample] = []
        self._lies: Lies | None = None

    def honest(self, now_ns: int, samples: list[tuple[Symmetric, Vector]]) -> None:
        """What the others have just measured: (R^-1, x̂) of each."""
        for held, (information, x_m) in zip(self._held[1:], samples, strict=True):
            held.append(Held(now_ns, information, apply(information, x_m), now_ns))
        since_ns = now_ns - WINDOW * 1_000_000_000
        self._held = [[sample for sample in held if sample.t_ns > since_ns] for held in self._held]

    def prepare(self, now_ns: int, rng: np.random.Generator) -> float:
        """Find the sample to say now. Returns the bound of the honest tracks, in metres."""
        others = range(1, len(self._held))
        tracks = {j: self._track([j], now_ns) for j in range(len(self._held))}
        truth = self._track(others, now_ns)
        everybody = self._track(range(len(self._held)), now_ns)
        without = {j: self._track([i for i in range(len(self._held)) if i != j], now_ns) for j in others}
        assert truth is not None
        assert everybody is not None
        honest = {f"r{j}": track for j in others if (track := tracks[j]) is not None}
        opinions = [opinion(name, track) for name, track in honest.items()]

        def moved_m(x_m: Vector, cov_m2: Symmetric) -> float:
            information = inverse(cov_m2)
            if information is None:
                return 0.0
            vector = apply(information, x_m)
            mine = begin(now_ns, information, vector) if tracks[0] is None else correct(tracks[0], information, vector)
            said = [opinion("r0", mine), *opinions]
            if "r0" not in vote(said).group:
                return 0.0
            doubt = doubts(said, beside=distances2({"r0": mine, **honest}))
            track = correct(everybody, information, vector)
            places = [(1.0 - doubt.strength, track.x_m, track.A)]
            for p, way in doubt.ways:
                (name,) = way.out
                left = truth if name == "r0" else correct(without[int(name[1:])] or truth, information, vector)
                places.append((doubt.strength * p, left.x_m, left.A))
            return math.dist(mixture(places)[0], truth.x_m)

        def gain(x_m: Array, cov_m2: Array) -> Array:
            rows = zip(x_m[:, 0].tolist(), cov_m2[:, 0], strict=True)
            return np.array([moved_m(tuple(x), floored(upper(cov))) for x, cov in rows])

        root_m = np.asarray(np.linalg.cholesky(square(truth.A)))
        self._lies = best_lies(gain, np.array(truth.x_m), root_m, 1, rng, self._lies, EFFORT)
        self._tell(now_ns, tuple(self._lies.x_m[0].tolist()), floored(upper(self._lies.cov_m2[0])))
        return bound_m(np.array([o.x_m for o in opinions]), np.array([square(o.cov_m2) for o in opinions]))

    def said(self, i: int, estimate: Estimate) -> Estimate:
        """What robot i says instead of `estimate`."""
        if i or estimate.gossip is None or not estimate.gossip.epoch.moving:
            return estimate
        now_ns = estimate.sent_ns
        mine = [replace(sample, age_ns=now_ns - sample.t_ns) for sample in self._samples[-COPIES:]]
        forged = [replace(mine[-1], origin=f"r{j}", signature=bytes(64)) for j in range(1, len(self._held))]
        room = 64 - len(mine) - len(forged)
        samples = (*mine, *forged, *estimate.gossip.samples[:room])
        return replace(estimate, valid=True, gossip=replace(estimate.gossip, samples=samples))

    def _tell(self, now_ns: int, x_m: Vector, cov_m2: Symmetric) -> None:
        """Say it, in as many samples as it takes: one knows no more than a camera can."""
        information = invert(cov_m2)
        copies = min(COPIES, math.ceil(trace(information) * R_FLOOR_M**2 / 3.0))
        each = times(1.0 / copies, information)
        vector = apply(each, x_m)
        self._held[0] += [Held(now_ns, each, vector, now_ns)] * copies
        number = len(self._samples)
        self._samples += [Sample("r0", 0, number + 1 + c, 0, each, vector, now_ns) for c in range(copies)]

    def _track(self, robots: range | list[int], now_ns: int) -> Track | None:
        track = FixedLagFilter().run([held for j in robots for held in self._held[j]], now_ns, now_ns)
        return None if track is None else predict(track, now_ns)


def opinion(name: str, track: Track) -> Opinion:
    """Where a robot's own samples place the target."""
    return Opinion(name, track.x_m, track.A, invert(track.A))


def floored(cov_m2: Symmetric) -> Symmetric:
    """A covariance that 16 samples of one moment can claim: raised as a whole where it is below."""
    xx, xy, xz, yy, yz, zz = cov_m2
    floor = R_FLOOR_M**2 / COPIES
    return xx + floor, xy, xz, yy + floor, yz, zz + floor


def square(a: Symmetric) -> Array:
    """(3, 3) of the upper triangle."""
    xx, xy, xz, yy, yz, zz = a
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
