"""A new epoch needs two robots: one that was knocked, or lies, must not empty everybody's table.

A robot whose own samples say that the target started or stopped moving proposes the next epoch. It begins when two have
proposed it, or where two neighbours are in it already: one of two is honest. Where fewer than three robots see the
target nobody could second, and one proposal is enough, but not more often than every ten seconds. A robot that has just
started joins the epoch of those that it hears, as soon as it has had the time to hear them all.

Epochs at rest have even counters, those in motion odd ones; every robot names the same epoch by the same counter.
"""

from __future__ import annotations

from agent.core.messages import Epoch, Proposal
from agent.core.savepoint import Revertible

ALARM_NS = 20_000_000_000  # a proposal that nobody seconds for so long was a knock
WITNESSES = 2  # one more than may lie
LEAST_NS = 10_000_000_000  # an epoch lasts so long before a single proposal ends it
BESIDE_NS = 3_000_000_000  # how long a neighbour counts as being in the epoch that it spoke of; all speak within it
JUMP = 1000  # epochs that a swarm may be ahead of a robot that has just started
LAST = 10**8  # no honest swarm gets there


def epoch_of(counter: int) -> Epoch:
    """The epoch with this number."""
    return Epoch(counter, counter % 2 == 1)


class EpochVote(Revertible):
    """Who proposes which epoch, as one robot knows it."""

    def __init__(self, me: str) -> None:
        self._me = me
        self._woke_ns: int | None = None  # since when we listen
        self._proposals: dict[str, tuple[Proposal, int]] = {}  # of each robot its newest, and when we first heard it
        self._witnesses: tuple[Proposal, ...] = ()  # for the epoch that we are in
        self._beside: dict[str, tuple[int, int]] = {}  # neighbour -> counter of its epoch, and when it said so
        self._began_ns: int | None = None  # the epoch that we are in; none: we just started, and met nobody in it

    def is_news(self, proposal: Proposal, epoch: Epoch) -> bool:
        """Whether it could matter and was not heard before."""
        if proposal.moving != epoch_of(proposal.counter).moving or not epoch.counter < proposal.counter <= LAST:
            return False
        old = self._proposals.get(proposal.proposer)
        return old is None or (proposal.counter, proposal.since_ns) > (old[0].counter, old[0].since_ns)

    def hear(self, proposal: Proposal, now_ns: int) -> None:
        """Take note of a proposal that is news and is believed."""
        self._proposals[proposal.proposer] = (proposal, now_ns)

    def neighbour(self, src: str, epoch: Epoch, now_ns: int) -> None:
        """Take note of the epoch that a neighbour is in."""
        self._beside[src] = (epoch.counter, now_ns)

    def propose(self, epoch: Epoch, now_ns: int) -> None:
        """Our own samples say that this epoch is over."""
        if not self._mine(epoch.counter + 1):
            self._proposals[self._me] = (Proposal(self._me, now_ns, epoch.counter + 1, not epoch.moving), now_ns)

    def unseconded(self, epoch: Epoch, now_ns: int) -> bool:
        """Whether a proposal of ours found nobody; it is taken back with this answer."""
        mine = self._mine(epoch.counter + 1)
        if mine is None or now_ns - mine[1] <= ALARM_NS:
            return False
        del self._proposals[self._me]
        return True

    def next(self, epoch: Epoch, seeing: int, now_ns: int) -> Epoch | None:
        """The epoch to begin now; None: the one that we are in goes on. seeing: robots known to see the target."""
        self._woke_ns = now_ns if self._woke_ns is None else self._woke_ns
        fresh = [p for p, heard_ns in self._proposals.values() if now_ns - heard_ns <= ALARM_NS]
        beside = [counter for counter, at_ns in self._beside.values() if now_ns - at_ns <= BESIDE_NS]
        if self._began_ns is None and epoch.counter in beside:
            self._began_ns = now_ns
        joins = self._began_ns is None and now_ns - self._woke_ns >= BESIDE_NS
        for counter in sorted({p.counter for p in fresh} | set(beside), reverse=True):
            if counter <= epoch.counter or counter > LAST:
                continue
            proposals = sum(p.counter == counter for p in fresh)
            there = sum(c >= counter for c in beside)
            if proposals >= WITNESSES or there >= WITNESSES:
                return epoch_of(counter)
            if joins and 0 < there == len(beside) and counter <= JUMP:
                return epoch_of(counter)
            if proposals and 0 < seeing <= WITNESSES and self._may_end_alone(epoch, counter, now_ns):
                return epoch_of(counter)
        return None

    def begin(self, epoch: Epoch, now_ns: int) -> None:
        """We are in this epoch from now on."""
        self._witnesses = tuple(p for p, _ in self._proposals.values() if p.counter == epoch.counter)[:WITNESSES]
        self._proposals = {n: held for n, held in self._proposals.items() if held[0].counter > epoch.counter}
        self._began_ns = now_ns

    def shown(self, now_ns: int) -> tuple[Proposal, ...]:
        """What to tell a neighbour: who witnessed our epoch, and fresh proposals for another."""
        fresh = (p for _, (p, heard_ns) in sorted(self._proposals.items()) if now_ns - heard_ns <= ALARM_NS)
        return (*self._witnesses, *fresh)

    def _mine(self, counter: int) -> tuple[Proposal, int] | None:
        held = self._proposals.get(self._me)
        return held if held is not None and held[0].counter == counter else None

    def _may_end_alone(self, epoch: Epoch, counter: int, now_ns: int) -> bool:
        """One robot's word leads on by an epoch in ten seconds."""
        if self._began_ns is None:
            return counter == epoch.counter + 1
        elapsed_ns = now_ns - self._began_ns
        return elapsed_ns >= LEAST_NS and counter <= epoch.counter + 1 + elapsed_ns // LEAST_NS
