"""The target rests: sums of samples are passed on, and the posterior is their robust mean."""

from __future__ import annotations

from collections.abc import Collection
from functools import partial

from agent.core.authority import HEARSAY
from agent.core.estimation.delivery_ledger import DeliveryLedger
from agent.core.estimation.evidence_checks import entry_fault, floored
from agent.core.estimation.evidence_table import Key, Table, mark
from agent.core.estimation.fuse import Fused, fuse
from agent.core.estimation.interface import Bearing, Posterior, Prior
from agent.core.estimation.mode import SEEN_NS, Conclusion, Me, outliving
from agent.core.estimation.motion import Innovation
from agent.core.matrix import apply, difference, distance2, inverse, plus, trace
from agent.core.messages import Entry, Epoch, Explain, Gossip, Holding
from agent.core.savepoint import Revertible
from agent.core.signed import entry_bytes

LET_GO_NS = 10_000_000_000  # for so long neighbours are told that an entry is here no more, and may send a better one


class StaticTarget(Revertible):
    """One robot's table in one epoch, and what its neighbours hold of it."""

    def __init__(self, me: Me, epoch: Epoch) -> None:
        self._me, self._epoch = me, epoch
        self._table = Table()
        self._ledgers: dict[str, DeliveryLedger[Key]] = {name: DeliveryLedger() for name in me.neighbours}
        self._change = 0
        self._news_ns: dict[str, int] = {}  # when each origin was last known to have measured
        self._let_go: dict[Key, int] = {}  # until when to say so
        self.outlived: int | None = None  # an incarnation of ours that is newer than the one we write under
        self._by_others: tuple[int, Posterior | None] = (0, None)  # at which change of the table; nobody's at first
        self._gain = 0.0  # share of the newest own sample in the own sum
        self._nis: float | None = None

    def add(self, number: int, prior: Prior | Bearing, now_ns: int) -> Innovation | None:
        """Take in an own sample. Returns its innovation against the own samples before it."""
        before = self._table.entries.get(self._me.key)
        information = self._table.measure(self._me.key, prior)
        self._gain = trace(information) / trace(self._table.entries[self._me.key].information)
        self._change += 1
        self._news_ns[self._me.key[0]] = now_ns
        random = None if before is None else inverse(before.information)
        self._nis = None
        if before is None or random is None or not isinstance(prior, Prior):
            return None
        step, covariance = difference(prior.x_m, apply(random, before.vector)), plus(random, floored(prior.random_m2))
        self._nis = distance2(covariance, step)
        return Innovation(step, covariance, self._nis)

    def hear(self, src: str, gossip: Gossip, arrived_ns: int) -> list[str]:
        faults, ledger, table = [], self._ledgers[src], self._table
        if self._me.authority.keys is None:  # who speaks to us makes void what others said in its name
            for key in [key for key in table.hearsay if key[0] == src]:
                self._drop(key, arrived_ns + LET_GO_NS)
        # Where the budget of a neighbour does not last, its own word comes first, then that of others near us.
        for entry in sorted(gossip.entries, key=lambda e: (e.origin != src, e.origin not in self._ledgers)):
            key = (entry.origin, entry.incarnation)
            if table.is_news(entry):
                fault = self._fault(src, entry, arrived_ns)
                if fault is None:
                    fault = table.merge(entry, self._me.authority.keys is None and src != entry.origin)
                    self._change += 1
                    self._let_go.pop(key, None)
                    self._news_ns[entry.origin] = arrived_ns
                if fault is not None and fault != HEARSAY:
                    faults.append(fault)
            self._acknowledge(ledger, key, entry.count, mark(entry))
        for line in gossip.digest:
            self._acknowledge(ledger, (line.origin, line.incarnation), line.newest, line.older)
        return faults

    def _acknowledge(self, ledger: DeliveryLedger[Key], key: Key, count: int, mark_: int) -> None:
        """A neighbour holds this; where it is as new as ours and another one, it holds ours not yet."""
        ours = self._table.entries.get(key)
        if ours is not None:
            ledger.acknowledge(key, count - (count == ours.count and mark_ != self._table.marks[key]))

    def _fault(self, src: str, entry: Entry, now_ns: int) -> str | None:
        """Why an entry that is news does not count."""
        authority, (me, incarnation) = self._me.authority, self._me.key
        if entry.origin == me and (entry.incarnation == incarnation or authority.keys is None):
            self.outlived = outliving(self.outlived, entry.incarnation, self._me, now_ns)
            return "own name"  # nobody else writes it, and without a signature nobody else can know what we wrote
        says = partial(entry_bytes, *self._me.subject, self._epoch, entry)
        fault = entry_fault(entry, self._me.bounds, now_ns)
        fault = fault or authority.fault(src, entry.origin, entry.signature, says, now_ns)
        if fault is None and entry.origin == me and entry.incarnation > incarnation:
            self.outlived = outliving(self.outlived, entry.incarnation, self._me, now_ns)
            return "own name"
        return fault

    def _drop(self, key: Key, until_ns: int) -> None:
        self._table.drop(key)
        self._let_go[key] = until_ns
        self._change += 1

    def began(self, me: Me) -> None:
        self._me, self.outlived = me, None

    def distrust(self, origins: Collection[str]) -> None:
        for key in [key for key in self._table.entries if key[0] in origins and key[0] != self._me.key[0]]:
            self._drop(key, 0)

    def seeing(self, now_ns: int) -> int:
        return sum(now_ns - news_ns <= SEEN_NS for news_ns in self._news_ns.values())

    def restarted(self, src: str) -> None:
        self._ledgers[src].forget()

    def say(self, to: str, now_ns: int) -> Gossip:
        entries, ledger = self._table.entries, self._ledgers[to]
        versions = {key: entry.count for key, entry in entries.items()}
        # Without a signature nobody is told what he measured himself.
        owed = versions if self._me.authority.keys is not None else {k: n for k, n in versions.items() if k[0] != to}
        ledger.drop(entries)
        chosen = ledger.pending(owed, self._me.key, self._me.max_entries)
        self._let_go = {key: until_ns for key, until_ns in self._let_go.items() if until_ns > now_ns}
        lines = [Holding(*key, version, self._table.marks[key]) for key, version in versions.items()]
        lines += [Holding(*key, 0) for key in self._let_go if key not in entries]
        return Gossip(
            self._epoch, entries=tuple(entries[k] for k in chosen), digest=ledger.digest(lines, self._change, now_ns)
        )

    def conclude(self, valid: bool, before: Posterior | None, now_ns: int) -> Conclusion:
        fused = fuse(self._table.opinions(), self._me.common_m2, self._me.liars)
        if fused is None:
            return Conclusion(before, "hold", 0.0, Explain(status="none", epoch=self._epoch))
        alpha = self._gain * fused.shares.get(self._me.key[0], 0.0) if valid else 0.0
        explain = Explain(
            status=fused.verdict,
            weights=fused.shares,
            votes=fused.votes,
            doubted={name: factor for name, factor in fused.factors.items() if factor < 1.0},
            epoch=self._epoch,
            nis=self._nis if valid else None,
            sway_m=fused.sway_m,
        )
        if fused.verdict == "ambiguous":
            return Conclusion(self._alone(valid) or before or _agreed(fused), "ambiguous", alpha, explain)
        doubted = fused.factors.get(self._me.key[0], 1.0) < 0.5
        return Conclusion(_agreed(fused), "fuse", alpha, explain, doubted)

    def by_others(self) -> Posterior | None:
        """Fused as all are. What robots have wrong in common does not show between them: `common_m2` is left out."""
        if self._by_others[0] != self._change:
            others = [opinion for opinion in self._table.opinions() if opinion.origin != self._me.key[0]]
            fused = fuse(others, liars=self._me.liars)
            place = None if fused is None or fused.verdict == "ambiguous" else _agreed(fused)
            self._by_others = self._change, place
        return self._by_others[1]

    def _alone(self, valid: bool) -> Posterior | None:
        """What our own samples say, while we see the target."""
        for opinion in self._table.opinions() if valid else ():
            if opinion.origin == self._me.key[0]:
                return Posterior(opinion.x_m, plus(opinion.cov_m2, self._me.common_m2))
        return None


def _agreed(fused: Fused) -> Posterior:
    return Posterior(fused.x_m, fused.cov_m2)
