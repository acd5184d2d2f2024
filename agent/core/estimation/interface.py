"""What every protocol offers to the kernel, in the paper's words: x̂ is the prior, x the posterior, S the valid set.

An estimator belongs to one robot and one target. It repeats one cycle: `hear` what neighbours said, `tick` once an
iteration, `say` the outcome to each neighbour, as often as the link allows, and at once what is `news`. The cache holds
what neighbours said last of the target.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

from agent.core.link_clocks import Way
from agent.core.messages import Estimate, Explain, Gossip, Symmetric, Vector
from agent.core.trust import CachedMessage, MessageCache

NOTHING: Symmetric = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class Prior(NamedTuple):
    """x̂: one measurement of this robot's own camera, world frame."""

    x_m: Vector
    random_m2: Symmetric  # covariance of what averages out over measurements
    t_ns: int  # when the sharpest frame was exposed
    systematic_m2: Symmetric = NOTHING  # of what does not: the same error in every measurement of this robot
    lever_m: Vector = (0.0, 0.0, 0.0)  # from the camera to there, world frame
    drift_m2_s2: Symmetric = NOTHING  # of how fast its systematic error changes

    @property
    def cov_m2(self) -> Symmetric:
        xx, xy, xz, yy, yz, zz = (a + b for a, b in zip(self.random_m2, self.systematic_m2, strict=True))
        return xx, xy, xz, yy, yz, zz


class Bearing(NamedTuple):
    """What a frame says of a target that is not swept: a line that it is on (target_state.bearing), world frame."""

    x_m: Vector  # on the line, at the range that is believed
    information: Symmetric  # 1/m^2, of rank 2; 3 where a range was measured too
    t_ns: int  # when the frame was exposed


class Posterior(NamedTuple):
    """x: what this robot believes after the update, world frame."""

    x_m: Vector
    cov_m2: Symmetric
    v_m_s: Vector = (0.0, 0.0, 0.0)  # where the protocol tells motion from rest; never sent
    t_ns: int = 0  # of a target that moves: when it was there


class Update(NamedTuple):
    """One iteration, explained: enough to say why the posterior is what it is."""

    t: int  # the iteration that this update led to
    rule: str  # which branch of the protocol fired
    alpha: float  # step size towards the own prior
    used: tuple[str, ...]  # N_i ∩ S^t: the neighbours that counted
    explain: Explain = Explain()


class Word(NamedTuple):
    """What goes to a neighbour beside `t` and `valid`: fields of messages.Estimate."""

    x_m: Vector | None
    cov_m2: Symmetric | None
    degree: int | None = None
    gossip: Gossip | None = None


class Estimator(Protocol):
    """The protocol of one robot for one target."""

    t: int  # iteration
    valid: bool  # in S^t: the last iteration had a prior

    @property
    def posterior(self) -> Posterior | None:
        """x by all that was heard and measured so far, or since the last iteration where the protocol says so."""

    def trust(self, keys: Mapping[str, bytes]) -> None:
        """Take over the public keys of the robots. Where this was never called nothing is signed."""

    def adopt(self, t: int) -> None:
        """A neighbour is at iteration t: late and restarted robots catch up with the swarm's index."""

    def hear(self, letter: CachedMessage[Estimate]) -> tuple[str, ...]:
        """Take in a message that the cache accepted. Returns the kinds of refusal of what in it was not believed."""

    def tick(self, prior: Prior | None, cache: EstimateCache, now_ns: int) -> Update:
        """One iteration: the newest usable word of each neighbour and, if the target was seen, a prior."""

    def news(self, to: str) -> bool:
        """Whether there is something that this neighbour should be told at once."""

    def say(self, to: str, now_ns: int, between: bool = False) -> Word:
        """What to tell this neighbour now, between two rounds the news alone. Time never decreases between calls."""


# --- cache ---
# What neighbours said last of one target, and which of them can be used.

HEARD_S = 2.0  # a neighbour's word of what it does not see holds for so long
ECHOES = 3  # the schema from which on all echo; of older recordings what was queued is all that is known
LATEST_T = 10**8  # iterations; a year has a third of it at one a second


class EstimateCache(MessageCache[Estimate]):
    """The newest message of each neighbour about one target; refuses what cannot be its next one."""

    def __init__(self, fleet: str, me: str, target: str, neighbours: tuple[str, ...]) -> None:
        super().__init__(fleet, me, neighbours)
        self._target = target

    def _addressed(self, message: Estimate) -> bool:
        return super()._addressed(message) and message.target == self._target

    def _echo_of(self, message: Estimate) -> tuple[int, int] | None:
        return message.echo

    def _way(self, message: Estimate, known: Way | None, late_ns: int) -> Way | None:
        return known if message.schema >= ECHOES else Way(late_ns, 0)

    def usable(self, now_ns: int, validity_ns: int) -> tuple[tuple[str, Estimate], ...]:
        """N_i ∩ S^t: neighbours heard of late that see the target, in the order of their names."""
        found = []
        for name, sender in self.senders.items():
            age_ns = self.age_ns(name, now_ns)
            if sender.newest is not None and age_ns is not None and age_ns <= validity_ns:
                estimate = sender.newest.message
                if estimate.valid and estimate.x_m is not None:
                    found.append((name, estimate))
        return tuple(found)

    def ages_s(self, now_ns: int) -> dict[str, float]:
        """How old the newest message of each neighbour is; those that never spoke are left out."""
        ages_ns = {name: self.age_ns(name, now_ns) for name in self.senders}
        return {name: age_ns * 1e-9 for name, age_ns in ages_ns.items() if age_ns is not None}

    def missed(self, now_ns: int) -> dict[str, float]:
        """What neighbours heard of late say of looks at where the target should be; see messages.Estimate."""
        fresh = {name for name, age_s in self.ages_s(now_ns).items() if age_s <= HEARD_S}
        newest = {name: sender.newest for name, sender in self.senders.items() if name in fresh}
        return {name: letter.message.missed for name, letter in newest.items() if letter is not None}

    def swarm_t(self, now_ns: int, validity_ns: int) -> int:
        """The iteration that the swarm has reached: the second largest of neighbours heard of late, for one of them may
        lie, or that of the only neighbour that there is; 0 when too few are heard."""
        reached = sorted(
            sender.newest.message.t
            for name, sender in self.senders.items()
            if sender.newest is not None and (self.age_ns(name, now_ns) or 0) <= validity_ns
        )
        needed = min(2, len(self.senders))
        return min(reached[-needed], LATEST_T) if reached and len(reached) >= needed else 0
