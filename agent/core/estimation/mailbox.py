"""What neighbours said last of one target, and which of them can be used."""

from __future__ import annotations

from agent.core.letters import Letters
from agent.core.messages import Estimate

LATEST_T = 10**8  # iterations; a year has a third of it at one a second


class Mailbox(Letters[Estimate]):
    """Newest letter per neighbour about one target; refuses what cannot be a neighbour's next word."""

    def __init__(self, fleet: str, me: str, target: str, neighbours: tuple[str, ...]) -> None:
        super().__init__(fleet, me, neighbours)
        self._target = target

    def _addressed(self, message: Estimate) -> bool:
        return super()._addressed(message) and message.target == self._target

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
        """How old the newest word of each neighbour is; those that never spoke are left out."""
        ages_ns = {name: self.age_ns(name, now_ns) for name in self.senders}
        return {name: age_ns * 1e-9 for name, age_ns in ages_ns.items() if age_ns is not None}

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
