"""The target rests: sums of samples are passed on, and the posterior is their robust mean."""

from __future__ import annotations

from agent.kernel.estimation.delivery_ledger import DeliveryLedger
from agent.kernel.estimation.evidence_checks import floored
from agent.kernel.estimation.evidence_table import Key, Table
from agent.kernel.estimation.fuse import Fused, fuse
from agent.kernel.estimation.interface import Posterior, Prior
from agent.kernel.estimation.matrix import apply, distance2, inverse, plus, trace
from agent.kernel.estimation.mode import Conclusion, Me
from agent.kernel.messages import Epoch, Explain, Gossip, Holding


class StaticTarget:
    """One robot's table in one epoch, and what its neighbours hold of it."""

    def __init__(self, me: Me, epoch: Epoch) -> None:
        self._me, self._epoch = me, epoch
        self._table = Table(me.bounds)
        self._ledgers: dict[str, DeliveryLedger[Key]] = {name: DeliveryLedger() for name in me.neighbours}
        self._change = 0
        self._gain = 0.0  # share of the newest own sample in the own sum
        self._nis: float | None = None

    def add(self, number: int, prior: Prior, now_ns: int) -> float | None:
        """Take in an own sample. Returns its normalised innovation squared against the own samples before it."""
        before = self._table.entries.get(self._me.key)
        information = self._table.measure(self._me.key, prior)
        self._gain = trace(information) / trace(self._table.entries[self._me.key].information)
        self._change += 1
        random = None if before is None else inverse(before.information)
        self._nis = None
        if before is not None and random is not None:
            x, y, z = apply(random, before.vector)
            step = (prior.x_m[0] - x, prior.x_m[1] - y, prior.x_m[2] - z)
            self._nis = distance2(plus(random, floored(prior.random_m2)), step)
        return self._nis

    def hear(self, src: str, gossip: Gossip, arrived_ns: int) -> list[str]:
        faults, ledger = [], self._ledgers[src]
        for entry in gossip.entries:
            key = (entry.origin, entry.incarnation)
            if key == self._me.key:
                mine = self._table.entries.get(key)
                if mine is None or entry.count > mine.count:
                    faults.append("forged")  # nobody else may write under our name
                continue
            news, fault = self._table.merge(entry, arrived_ns)
            if fault is not None:
                faults.append(fault)
                continue
            ledger.acknowledge(key, entry.count)
            self._change += news
        for line in gossip.digest:
            if (line.origin, line.incarnation) in self._table.entries:
                ledger.acknowledge((line.origin, line.incarnation), line.newest)
        return faults

    def restarted(self, src: str) -> None:
        self._ledgers[src].forget()

    def say(self, to: str, now_ns: int) -> Gossip:
        entries, ledger = self._table.entries, self._ledgers[to]
        versions = {key: entry.count for key, entry in entries.items()}
        chosen = ledger.pending(versions, self._me.key, self._me.max_entries)
        lines = [Holding(*key, version) for key, version in versions.items()]
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
        return Conclusion(_agreed(fused), "fuse", alpha, explain)

    def _alone(self, valid: bool) -> Posterior | None:
        """What our own samples say, while we see the target."""
        for opinion in self._table.opinions() if valid else ():
            if opinion.origin == self._me.key[0]:
                return Posterior(opinion.x_m, plus(opinion.cov_m2, self._me.common_m2))
        return None


def _agreed(fused: Fused) -> Posterior:
    return Posterior(fused.x_m, fused.cov_m2)
