"""`paper` with three repairs and nothing else: weights by degree, a self term, and no reset when alone.

    x_i^{t+1} = (1 - alpha) (w_ii x_i^t + sum_j w_ij x_j^t) + alpha x̂_i^t,   w_ij = 1 / (1 + max(d_i, d_j))

over j in N_i ∩ S^t, with alpha = 1 / (t + 1). A robot that sees the target keeps the weight of neighbours that are
silent (w_ii = 1 - sum_j w_ij) and starts from its first sample; one that does not see it takes the weighted mean of
what it is told, without itself. Metropolis weights are doubly stochastic, so every robot ends at the plain mean of
all samples (Xiao, Boyd and Lall, IPSN 2005); on a graph with two colours the self term halves the variance that
`paper` keeps.

It withstands lost messages, and no robot that is wrong: x_j is believed wherever it is, so one that lies moves all, by
the lie itself within a minute, and for long afterwards. `clip` limits that. Each x_j is drawn in to x_i until they are
3 sigma_i apart, and sigma_i^2 is the trace of the covariance that the own samples alone give their mean, for that of
x_i holds what neighbours claim. A lie then moves x_i by 3 w_ij sigma_i an iteration instead of any distance: slower,
not in vain, and what it did is forgotten with 1 / t. A robot that never saw the target has nothing to hold against it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from agent.core.estimation.interface import Posterior, Prior, Update, Word
from agent.core.estimation.mailbox import Mailbox
from agent.core.estimation.paper import UNKNOWN, mix
from agent.core.letters import Letter
from agent.core.matrix import trace
from agent.core.messages import Estimate, Explain, Vector
from agent.core.savepoint import Revertible

CLIP = 3.0  # sigma of the own samples' mean: honest neighbours, who share most of their past, are nearer


class Metropolis(Revertible):
    """State of one robot for one target."""

    def __init__(self, me: str, validity_ns: int, degree: int, clip: bool = False) -> None:
        self._me, self._validity_ns, self._degree, self._clip = me, validity_ns, degree, clip
        self._samples = 0
        self._traces_m2 = 0.0  # of their covariances, summed
        self.t = 0
        self.valid = False
        self.posterior: Posterior | None = None

    def by_others(self) -> Posterior | None:
        return None  # means have no origins

    def trust(self, keys: Mapping[str, bytes]) -> None:
        pass  # a belief has no origin that could sign it

    def adopt(self, t: int) -> None:
        if t > self.t + 1:  # see Paper.adopt
            self.t = t - 1

    def hear(self, letter: Letter[Estimate]) -> tuple[str, ...]:
        return ()

    def say(self, to: str, now_ns: int) -> Word:
        x_m, cov_m2 = self.posterior[:2] if self.posterior else (None, None)
        return Word(x_m, cov_m2, degree=self._degree)

    def tick(self, prior: Prior | None, mailbox: Mailbox, now_ns: int) -> Update:
        usable = mailbox.usable(now_ns, self._validity_ns)
        said = {name: Posterior(e.x_m, e.cov_m2 or UNKNOWN) for name, e in usable if e.x_m is not None}
        weights = {name: self._weight(e) for name, e in usable}
        self.valid = prior is not None
        if prior is not None:
            self._samples, self._traces_m2 = self._samples + 1, self._traces_m2 + trace(prior.cov_m2)
        anchor = self.posterior or prior
        if self._clip and anchor is not None and self._samples:
            said = {name: p._replace(x_m=self._drawn_in(p.x_m, anchor.x_m)) for name, p in said.items()}
        alpha = 0.0
        if prior is not None and self.posterior is None and not said:
            alpha, rule = 1.0, "alone"
            self.posterior = Posterior(prior.x_m, prior.cov_m2)
        elif prior is not None:
            alpha = 1.0 / (self.t + 1)
            said[self._me] = self.posterior or Posterior(prior.x_m, prior.cov_m2)
            weights[self._me] = 1.0 - sum(weights.values())
            self.posterior = mix([(said[n], weights[n]) for n in said], prior, alpha)
            rule = "mix" if usable else "alone"
        elif said:
            total = sum(weights.values())
            weights = {name: w / total for name, w in weights.items()}
            self.posterior, rule = mix([(said[n], weights[n]) for n in said], None, 0.0), "told"
        else:
            rule = "hold"
        self.t += 1
        shares = {name: (1.0 - alpha) * w for name, w in weights.items()}
        explain = Explain(weights=shares, ages_s=mailbox.ages_s(now_ns))
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
