"""The paper's protocol, equation (ac) and Algorithm 1 read literally (arXiv 2506.09876, section 4).

    x_i^{t+1} = sum_{j in N_i ∩ S^t} (1 - alpha) w_ij x_j^t  +  alpha x̂_i^t

with w_ij = 1 / |N_i ∩ S^t| and alpha = 1 / (t + 1), both left open by the paper. Its flaws are kept: robots do not
average with themselves, and one that sees the target but hears nobody starts again from its newest sample. Where the
paper demands two things at once (blind, and no valid neighbour) the robot holds what it has.

It withstands neither lost messages nor a robot that is wrong. A neighbour's word is believed wherever it is, so one
that lies takes all with it, as far as the tank reaches; who sees the target has only alpha against it, which shrinks.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from agent.core.estimation.interface import Posterior, Prior, Update, Word
from agent.core.estimation.mailbox import Mailbox
from agent.core.letters import Letter
from agent.core.messages import Estimate, Explain, Symmetric, Vector
from agent.core.savepoint import Revertible


class Paper(Revertible):
    """State of one robot for one target."""

    def __init__(self, validity_ns: int) -> None:
        self._validity_ns = validity_ns
        self.t = 0
        self.valid = False
        self.posterior: Posterior | None = None

    def by_others(self) -> Posterior | None:
        return None  # means have no origins

    def trust(self, keys: Mapping[str, bytes]) -> None:
        pass  # a belief has no origin that could sign it

    def adopt(self, t: int) -> None:
        # One ahead is a neighbour in the same iteration that ticked first, and who follows ends up beside it, not in
        # front: else robots would drive each other through more iterations than there are periods, and alpha would
        # shrink before the samples are in.
        if t > self.t + 1:
            self.t = t - 1

    def hear(self, letter: Letter[Estimate]) -> tuple[str, ...]:
        return ()  # only the newest word counts, and the mailbox has it

    def say(self, to: str, now_ns: int) -> Word:
        return Word(*self.posterior[:2]) if self.posterior else Word(None, None)

    def tick(self, prior: Prior | None, mailbox: Mailbox, now_ns: int) -> Update:
        usable = mailbox.usable(now_ns, self._validity_ns)
        said = [(Posterior(e.x_m, e.cov_m2 or UNKNOWN), 1.0 / len(usable)) for _, e in usable if e.x_m is not None]
        self.valid = prior is not None
        alpha = 0.0
        if said and prior is not None:
            alpha = 1.0 / (self.t + 1)
            self.posterior, rule = mix(said, prior, alpha), "mix"
        elif said:
            self.posterior, rule = mix(said, None, 0.0), "told"
        elif prior is not None:
            alpha = 1.0
            self.posterior, rule = Posterior(prior.x_m, prior.cov_m2), "alone"
        else:
            rule = "hold"
        self.t += 1
        weights = {name: (1.0 - alpha) / len(usable) for name, _ in usable}
        explain = Explain(weights=weights, ages_s=mailbox.ages_s(now_ns))
        return Update(self.t, rule, alpha, tuple(weights), explain)


UNKNOWN: Symmetric = (1.0, 0.0, 0.0, 1.0, 0.0, 1.0)  # 1 m: a neighbour that states no covariance


def mix(said: Sequence[tuple[Posterior, float]], prior: Prior | None, alpha: float) -> Posterior:
    """(1 - alpha) sum w x + alpha x̂ over weights that sum to 1, and a covariance for it.

    The paper has no covariance. Neighbours share most of their past, so their mean is credited with the mean of
    their covariances (full correlation, an upper bound); the own prior is new and independent.
    """
    keep = 1.0 - alpha
    x = [math.fsum(keep * w * p.x_m[k] for p, w in said) for k in range(3)]
    cov = [math.fsum(keep * keep * w * p.cov_m2[k] for p, w in said) for k in range(6)]
    if prior is not None:
        x = [a + alpha * b for a, b in zip(x, prior.x_m, strict=True)]
        cov = [a + alpha * alpha * b for a, b in zip(cov, prior.cov_m2, strict=True)]
    return Posterior(_vector(x), _symmetric(cov))


def _vector(v: Sequence[float]) -> Vector:
    return (v[0], v[1], v[2])


def _symmetric(v: Sequence[float]) -> Symmetric:
    return (v[0], v[1], v[2], v[3], v[4], v[5])
