"""The newest message of each neighbour, and how far it can be trusted to be fresh.

Clocks of different robots need not agree. The smallest (arrival - sent) of the last minute stands for the constant
part of that difference; what a message took beyond it is time it spent queued, and counts as age.
"""

from __future__ import annotations

from typing import NamedTuple

from agent.kernel.codec import Refusal
from agent.kernel.messages import Estimate

TRANSIT_WINDOW_NS = 60_000_000_000  # over which the quickest message is remembered
TRANSIT_BIN_NS = 1_000_000_000  # resolution of that memory: 60 numbers a neighbour


class Letter(NamedTuple):
    """A believed message with its time of arrival on this robot's clock."""

    estimate: Estimate
    arrived_ns: int
    late_ns: int  # queued on the way, beyond the quickest message of the last minute


class Sender(NamedTuple):
    """Counters of one neighbour."""

    heard: int = 0
    gaps: int = 0
    newest: Letter | None = None


class Mailbox:
    """Newest letter per neighbour; refuses what cannot be a neighbour's next word."""

    def __init__(self, fleet: str, me: str, target: str, neighbours: tuple[str, ...]) -> None:
        self._fleet, self._me, self._target = fleet, me, target
        self.senders: dict[str, Sender] = {name: Sender() for name in sorted(neighbours)}
        self._quickest: dict[str, dict[int, int]] = {name: {} for name in self.senders}

    def put(self, src: str, estimate: Estimate, arrived_ns: int) -> Letter:
        """Keep a decoded message that came on the key of `src`. Raises Refusal when it does not belong there."""
        if src not in self.senders:
            raise Refusal("address", "not a neighbour")
        if estimate.src != src:
            raise Refusal("address", "sender differs from its key")
        if (estimate.fleet, estimate.dst, estimate.target) != (self._fleet, self._me, self._target):
            raise Refusal("address", "not addressed to us")
        sender = self.senders[src]
        restarted = sender.newest is None or sender.newest.estimate.incarnation != estimate.incarnation
        gap = 0
        if restarted:
            self._quickest[src] = {}
        else:
            assert sender.newest is not None
            gap = estimate.seq - sender.newest.estimate.seq - 1
            if gap < 0:
                raise Refusal("order", "repeated or out of order")
        late_ns = self._late_ns(src, arrived_ns - estimate.sent_ns, arrived_ns)
        letter = Letter(estimate, arrived_ns, late_ns)
        self.senders[src] = Sender(sender.heard + 1, sender.gaps + gap, letter)
        return letter

    def age_ns(self, src: str, now_ns: int) -> int | None:
        """How old the newest word of a neighbour is; None when it never spoke."""
        letter = self.senders[src].newest
        return None if letter is None else now_ns - letter.arrived_ns + letter.late_ns

    def usable(self, now_ns: int, validity_ns: int) -> tuple[tuple[str, Estimate], ...]:
        """N_i ∩ S^t: neighbours heard of late that see the target, in the order of their names."""
        found = []
        for name, sender in self.senders.items():
            age_ns = self.age_ns(name, now_ns)
            if sender.newest is not None and age_ns is not None and age_ns <= validity_ns:
                estimate = sender.newest.estimate
                if estimate.valid and estimate.x_m is not None:
                    found.append((name, estimate))
        return tuple(found)

    def ages_s(self, now_ns: int) -> dict[str, float]:
        """How old the newest word of each neighbour is; those that never spoke are left out."""
        ages_ns = {name: self.age_ns(name, now_ns) for name in self.senders}
        return {name: age_ns * 1e-9 for name, age_ns in ages_ns.items() if age_ns is not None}

    def newest_t(self, now_ns: int, validity_ns: int) -> int:
        """The largest iteration that a neighbour heard of late has reached; 0 when all are silent."""
        return max(
            (
                sender.newest.estimate.t
                for name, sender in self.senders.items()
                if sender.newest is not None and (self.age_ns(name, now_ns) or 0) <= validity_ns
            ),
            default=0,
        )

    def _late_ns(self, src: str, transit_ns: int, arrived_ns: int) -> int:
        bins = self._quickest[src]
        now_bin = arrived_ns // TRANSIT_BIN_NS
        bins[now_bin] = min(transit_ns, bins.get(now_bin, transit_ns))
        for old in [b for b in bins if b < now_bin - TRANSIT_WINDOW_NS // TRANSIT_BIN_NS]:
            del bins[old]
        return transit_ns - min(bins.values())
