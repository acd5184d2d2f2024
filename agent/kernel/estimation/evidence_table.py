"""Who has measured what of a target at rest: a map that only grows, and grows to the same from any order of news.

Each robot writes one entry for each of its starts (its incarnation), the sum of all it measured since. Newer replaces
older, so merging is commutative, associative and idempotent: loss, repeats, reordering and loops among the relays
cannot count a sample twice. After a restart a robot writes under a new incarnation, and its old entry comes back to
it from the neighbours.
"""

from __future__ import annotations

from agent.kernel.estimation.evidence_checks import Bounds, First, entry_fault, floored
from agent.kernel.estimation.fuse import Opinion
from agent.kernel.estimation.interface import Prior
from agent.kernel.estimation.matrix import ZERO, apply, inverse, plus, times
from agent.kernel.messages import Entry, Symmetric, Vector

Key = tuple[str, int]  # origin, incarnation

INCARNATIONS = 16  # of one origin, the newest: a robot that restarts all day must not fill everybody's memory


class Table:
    """All entries of one epoch of one target: a state-based CRDT, whose join is `merge`."""

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self.entries: dict[Key, Entry] = {}
        self._first: dict[Key, First] = {}
        self._opinions: dict[str, Opinion | None] = {}  # None: to be made again, or not yet possible

    def measure(self, key: Key, prior: Prior) -> Symmetric:
        """Add a sample of our own; returns its information R^-1 in 1/m^2.

        Raises ValueError where the covariance of the prior has no inverse.
        """
        information = inverse(floored(prior.random_m2))
        if information is None:
            raise ValueError(f"covariance of the prior {prior.random_m2} is singular")
        x, y, z = apply(information, prior.x_m)
        old = self.entries.get(key)
        if old is None:
            entry = Entry(*key, 1, information, (x, y, z), prior.systematic_m2)
        else:
            count, (ox, oy, oz) = old.count + 1, old.vector
            drift = times((count - 1) / count, old.systematic_m2)
            systematic = plus(drift, times(1.0 / count, prior.systematic_m2))
            entry = Entry(*key, count, plus(old.information, information), (ox + x, oy + y, oz + z), systematic)
        self._put(key, entry)
        return information

    def merge(self, entry: Entry, now_ns: int) -> tuple[bool, str | None]:
        """Take in an entry from a neighbour: (whether it was news, why it was not believed)."""
        key = (entry.origin, entry.incarnation)
        old = self.entries.get(key)
        if old is not None and entry.count <= old.count:
            return False, None
        fault = entry_fault(entry, old, self._first.get(key), self._bounds, now_ns)
        if fault is not None:
            return False, fault
        self._first.setdefault(key, First(entry.count, now_ns))
        self._put(key, entry)
        return key in self.entries, None

    def opinions(self) -> list[Opinion]:
        """What each origin says by itself, in the order of their names; those that cannot place the target yet not."""
        return [opinion for name in sorted(self._opinions) if (opinion := self._opinion(name)) is not None]

    def _put(self, key: Key, entry: Entry) -> None:
        self.entries[key] = entry
        self._opinions[key[0]] = None
        mine = sorted(k for k in self.entries if k[0] == key[0]) if len(self.entries) > INCARNATIONS else []
        for old in mine[:-INCARNATIONS]:
            del self.entries[old]
            self._first.pop(old, None)

    def _opinion(self, origin: str) -> Opinion | None:
        if self._opinions[origin] is None:
            keys = sorted(key for key in self.entries if key[0] == origin)
            self._opinions[origin] = opinion(origin, [self.entries[key] for key in keys])
        return self._opinions[origin]


def opinion(origin: str, entries: list[Entry]) -> Opinion | None:
    """One origin's mean over all its incarnations; None while some direction is unseen.

    Its systematic error is the same in every sample and in every incarnation, so it enters once and is never divided.
    """
    information, vector, total = ZERO, (0.0, 0.0, 0.0), sum(entry.count for entry in entries)
    systematic = ZERO
    for entry in entries:
        information = plus(information, entry.information)
        vector = _sum(vector, entry.vector)
        systematic = plus(systematic, times(entry.count / total, entry.systematic_m2))
    random = inverse(information)
    if random is None:
        return None
    covariance = plus(random, systematic)
    precision = inverse(covariance)
    return None if precision is None else Opinion(origin, apply(random, vector), covariance, precision)


def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]
