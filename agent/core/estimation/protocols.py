"""The protocols `paper` and `metropolis`, and the choice of one: `fleet.estimation.protocol` gives an estimator for one
robot and one target. The third protocol, `evidence`, is in evidence.py.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from agent.core.config import Fleet, Follow, Search, Target
from agent.core.estimation.evidence import Evidence
from agent.core.estimation.evidence_table import Bounds
from agent.core.estimation.fuse import NONE, Shared
from agent.core.estimation.interface import EstimateCache, Estimator, Posterior, Prior, Update, Word
from agent.core.estimation.track import ROLLING, Dynamics, swimming
from agent.core.linear_algebra import plus, trace
from agent.core.messages import Estimate, Explain, Symmetric, Vector
from agent.core.step_transaction import Revertible
from agent.core.trust import CachedMessage, Verify, verify_signature

# --- choice of the protocol ---

PURSUIT_S = 0.1  # an iteration with a target that is pursued: a frame at 10 Hz, and a window of two and a half seconds


def estimator(fleet: Fleet, me: str, target: str, incarnation: int, verify: Verify = verify_signature) -> Estimator:
    """A fresh estimator of `target` for the robot `me`; `incarnation` tells this start from the ones before.

    verify: how the signatures of others are checked; an experiment may take a check that is right and costs no time.
    """
    assert target in fleet.target
    validity_ns = round(fleet.estimation.validity_s * 1e9)
    neighbours = fleet.robot[me].neighbours
    shared = shared_of(fleet, target)
    match fleet.estimation.protocol:
        case "paper":
            return Paper(validity_ns, shared)
        case "metropolis":
            return Metropolis(me, validity_ns, len(neighbours), fleet.estimation.clip, shared)
        case "evidence":
            bounds = Bounds(frozenset(fleet.robot), fleet.tank.size_m, iteration_ns(fleet, target))
            return Evidence(
                me,
                incarnation,
                neighbours,
                validity_ns,
                bounds,
                shared=shared,
                liars=fleet.estimation.liars,
                subject=(fleet.fleet, target),
                verify=verify,
                dynamics=dynamics(fleet.target[target]),
                links=frozenset((name, near) for name, robot in fleet.robot.items() for near in robot.neighbours),
            )


def shared_of(fleet: Fleet, target: str) -> Shared:
    """What all robots have wrong alike of where that target is, by the budget of the fleet file and by how well the
    radius of a ball is known."""
    budget, of = fleet.budget, fleet.target[target]
    by_size = of.radius_m is not None and fleet.ranging.cues != "focus"
    radius = of.radius_sigma_m / of.radius_m if by_size and of.radius_m else 0.0
    level, survey = budget.level_m**2, budget.survey_m**2
    return Shared((survey, 0.0, 0.0, survey, 0.0, level), math.hypot(budget.scale, radius))


def iteration_ns(fleet: Fleet, target: str) -> int:
    """The period of the protocol's iterations with that target, the same on all robots."""
    iteration_s = fleet.estimation.iteration_s
    return round(1e9 * (min(iteration_s, PURSUIT_S) if target in pursued(fleet) else iteration_s))


def pursued(fleet: Fleet) -> tuple[str, ...]:
    """Targets that swim and that a robot of the fleet is to follow or to search for: their frames give bearings. Only
    the protocol `evidence` takes these."""
    if fleet.estimation.protocol != "evidence":
        return ()
    told = {robot.behaviour.target for robot in fleet.robot.values() if isinstance(robot.behaviour, Follow | Search)}
    return tuple(name for name, target in fleet.target.items() if name in told and target.speed_m_s is not None)


def dynamics(target: Target) -> Dynamics:
    """How the target moves by the fleet file; where that says nothing, like a ball."""
    if target.speed_m_s is None or target.turn_s is None:
        return ROLLING
    return swimming(target.speed_m_s, target.turn_s)


# --- what protocols of means share ---


class Means(Revertible):
    """A protocol whose robots tell their means: a mean has no origin that could sign it."""

    def __init__(self, shared: Shared) -> None:
        self._shared = shared
        self._mean: Posterior | None = None  # without what all robots have wrong alike
        self.t = 0  # iterations
        self.valid = False

    @property
    def posterior(self) -> Posterior | None:
        mean = self._mean
        return None if mean is None else mean._replace(cov_m2=plus(mean.cov_m2, self._shared.place_m2))

    def _stretched(self, prior: Prior) -> Prior:
        """A prior that has in its systematic error what the scale of all ranges makes of its lever."""
        return prior._replace(systematic_m2=plus(prior.systematic_m2, self._shared.scale_m2(prior.lever_m)))

    def trust(self, keys: Mapping[str, bytes]) -> None:
        pass  # a belief has no origin that could sign it

    def news(self, to: str) -> bool:
        return False  # a mean is new once an iteration, and all are told in rounds

    def adopt(self, t: int) -> None:
        # One ahead is a neighbour in the same iteration that ticked first, and a robot that follows ends up beside it,
        # not in front: else robots would drive each other through more iterations than there are periods, and alpha
        # would shrink before the samples are in.
        if t > self.t + 1:
            self.t = t - 1


# --- paper ---
# The paper's protocol, equation (ac) and Algorithm 1 read literally (arXiv 2506.09876, section 4).
#
# x_i^{t+1} = sum_{j in N_i ∩ S^t} (1 - alpha) w_ij x_j^t  +  alpha x̂_i^t
#
# with w_ij = 1 / |N_i ∩ S^t| and alpha = 1 / (t + 1), both left open by the paper. Its flaws are kept: robots do not
# average with themselves, and one that sees the target but hears no other starts again from its newest sample. Where
# the paper demands two things at once (blind, and no valid neighbour) the robot holds what it has.
#
# It withstands neither lost messages nor a robot that is wrong. The place that a neighbour states is believed wherever
# it is, so one robot that lies takes all with it, as far as the tank reaches; a robot that sees the target has only
# alpha against it, which shrinks.

UNKNOWN: Symmetric = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)  # 1 m: a neighbour that states no covariance


class Paper(Means):
    """State of one robot for one target."""

    def __init__(self, validity_ns: int, shared: Shared = NONE) -> None:
        super().__init__(shared)
        self._validity_ns = validity_ns

    def hear(self, letter: CachedMessage[Estimate]) -> tuple[str, ...]:
        return ()  # only the newest word counts, and the cache has it

    def say(self, to: str, now_ns: int, between: bool = False) -> Word:
        return Word(*self._mean[:2]) if self._mean else Word(None, None)

    def tick(self, prior: Prior | None, cache: EstimateCache, now_ns: int) -> Update:
        usable = cache.usable(now_ns, self._validity_ns)
        said = [(Posterior(e.x_m, e.cov_m2 or UNKNOWN), 1.0 / len(usable)) for _, e in usable if e.x_m is not None]
        self.valid = prior is not None
        prior = None if prior is None else self._stretched(prior)
        alpha = 0.0
        if said and prior is not None:
            alpha = 1.0 / (self.t + 1)
            self._mean, rule = mix(said, prior, alpha), "mix"
        elif said:
            self._mean, rule = mix(said, None, 0.0), "told"
        elif prior is not None:
            alpha = 1.0
            self._mean, rule = Posterior(prior.x_m, prior.cov_m2), "alone"
        else:
            rule = "hold"
        self.t += 1
        weights = {name: (1.0 - alpha) / len(usable) for name, _ in usable}
        explain = Explain(weights=weights, ages_s=cache.ages_s(now_ns))
        return Update(self.t, rule, alpha, tuple(weights), explain)


def mix(said: Sequence[tuple[Posterior, float]], prior: Prior | None, alpha: float) -> Posterior:
    """(1 - alpha) sum w x + alpha x̂ over weights that sum to 1, and a covariance for it.

    The paper has no covariance. Neighbours share most of their past, so their mean is credited with the mean of
    their covariances (full correlation, an upper bound). The own prior is new and independent, but for what stays in
    all of this robot's samples: that does not average out.
    """
    keep = 1.0 - alpha
    x = [math.fsum(keep * w * p.x_m[k] for p, w in said) for k in range(3)]
    cov = [math.fsum(keep * keep * w * p.cov_m2[k] for p, w in said) for k in range(6)]
    if prior is not None:
        x = [a + alpha * b for a, b in zip(x, prior.x_m, strict=True)]
        parts = zip(cov, prior.random_m2, prior.systematic_m2, strict=True)
        cov = [a + alpha * alpha * random + (1.0 - keep * keep) * stays for a, random, stays in parts]
    return Posterior(_vector(x), _symmetric(cov))


def _vector(v: Sequence[float]) -> Vector:
    return (v[0], v[1], v[2])


def _symmetric(v: Sequence[float]) -> Symmetric:
    return (v[0], v[1], v[2], v[3], v[4], v[5])


# --- metropolis ---
# `paper` with three repairs and nothing else: weights by degree, a self term, and no reset when alone.
#
# x_i^{t+1} = (1 - alpha) (w_ii x_i^t + sum_j w_ij x_j^t) + alpha x̂_i^t,   w_ij = 1 / (1 + max(d_i, d_j))
#
# over j in N_i ∩ S^t, with alpha = 1 / (t + 1). A robot that sees the target keeps the weight of neighbours that are
# silent (w_ii = 1 - sum_j w_ij) and starts from its first sample; one that does not see it takes the weighted mean of
# what it is told, without itself. Metropolis weights are doubly stochastic, so every robot ends at the plain mean of
# all samples (Xiao, Boyd and Lall, IPSN 2005); on a graph with two colours the self term halves the variance that
# `paper` keeps.
#
# It withstands lost messages, and no robot that is wrong: x_j is believed wherever it is, so one that lies moves all,
# by the lie itself within a minute, and for long afterwards. `clip` limits that. Each x_j is drawn in to x_i until they
# are 3 sigma_i apart, and sigma_i^2 is the trace of the covariance that the own samples alone give their mean, for that
# of x_i holds what neighbours claim. A lie then moves x_i by 3 w_ij sigma_i an iteration instead of any distance: it
# moves x_i more slowly, but it still does, and its effect fades with 1 / t. A robot that never saw the target has
# nothing to hold against it.

CLIP = 3.0  # sigma of the own samples' mean: honest neighbours share most of their past and are nearer


class Metropolis(Means):
    """State of one robot for one target."""

    def __init__(self, me: str, validity_ns: int, degree: int, clip: bool = False, shared: Shared = NONE) -> None:
        super().__init__(shared)
        self._me, self._validity_ns, self._degree, self._clip = me, validity_ns, degree, clip
        self._samples = 0
        self._traces_m2 = 0.0  # of their covariances, summed

    def hear(self, letter: CachedMessage[Estimate]) -> tuple[str, ...]:
        return ()

    def say(self, to: str, now_ns: int, between: bool = False) -> Word:
        x_m, cov_m2 = self._mean[:2] if self._mean else (None, None)
        return Word(x_m, cov_m2, degree=self._degree)

    def tick(self, prior: Prior | None, cache: EstimateCache, now_ns: int) -> Update:
        usable = cache.usable(now_ns, self._validity_ns)
        said = {name: Posterior(e.x_m, e.cov_m2 or UNKNOWN) for name, e in usable if e.x_m is not None}
        weights = {name: self._weight(e) for name, e in usable}
        self.valid = prior is not None
        prior = None if prior is None else self._stretched(prior)
        if prior is not None:
            self._samples, self._traces_m2 = self._samples + 1, self._traces_m2 + trace(prior.cov_m2)
        anchor = self._mean or prior
        if self._clip and anchor is not None and self._samples:
            said = {name: p._replace(x_m=self._drawn_in(p.x_m, anchor.x_m)) for name, p in said.items()}
        alpha = 0.0
        if prior is not None and self._mean is None and not said:
            alpha, rule = 1.0, "alone"
            self._mean = Posterior(prior.x_m, prior.cov_m2)
        elif prior is not None:
            alpha = 1.0 / (self.t + 1)
            said[self._me] = self._mean or Posterior(prior.x_m, prior.cov_m2)
            weights[self._me] = 1.0 - sum(weights.values())
            self._mean = mix([(said[n], weights[n]) for n in said], prior, alpha)
            rule = "mix" if usable else "alone"
        elif said:
            total = sum(weights.values())
            weights = {name: w / total for name, w in weights.items()}
            self._mean, rule = mix([(said[n], weights[n]) for n in said], None, 0.0), "told"
        else:
            rule = "hold"
        self.t += 1
        shares = {name: (1.0 - alpha) * w for name, w in weights.items()}
        explain = Explain(weights=shares, ages_s=cache.ages_s(now_ns))
        return Update(self.t, rule, alpha, tuple(name for name, _ in usable), explain)

    def _drawn_in(self, x_m: Vector, anchor_m: Vector) -> Vector:
        """A neighbour's place, no farther from ours than the own samples make believable."""
        reach_m = CLIP * math.sqrt(self._traces_m2) / self._samples
        apart_m = math.dist(x_m, anchor_m)
        if apart_m <= reach_m:
            return x_m
        x, y, z = (a + reach_m / apart_m * (b - a) for a, b in zip(anchor_m, x_m, strict=True))
        return x, y, z

    def _weight(self, estimate: Estimate) -> float:
        # A neighbour that does not state its degree is taken to have ours.
        return 1.0 / (1 + max(self._degree, estimate.degree or self._degree))
