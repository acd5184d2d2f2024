"""What every protocol offers to the kernel, in the paper's words: x̂ is the prior, x the posterior, S the valid set."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from agent.estimation.mailbox import Mailbox
from agent.messages import Symmetric, Vector


class Prior(NamedTuple):
    """x̂: one measurement of this robot's own camera, world frame."""

    x_m: Vector
    cov_m2: Symmetric
    t_ns: int  # when the sharpest frame was exposed


class Posterior(NamedTuple):
    """x: what this robot believes after the update, world frame."""

    x_m: Vector
    cov_m2: Symmetric


class Update(NamedTuple):
    """One iteration, explained: enough to say why the posterior is what it is."""

    t: int  # the iteration that this update led to
    rule: str  # which branch of the protocol fired
    alpha: float  # step size towards the own prior
    used: tuple[str, ...]  # N_i ∩ S^t: the neighbours that counted


class Estimator(Protocol):
    t: int
    valid: bool  # in S^t: the last iteration had a prior
    posterior: Posterior | None

    def adopt(self, t: int) -> None:
        """A neighbour is at iteration t: late and restarted robots catch up with the swarm's index."""

    def tick(self, prior: Prior | None, mailbox: Mailbox, now_ns: int) -> Update:
        """One iteration: the newest usable word of each neighbour and, if the target was seen, a prior."""
