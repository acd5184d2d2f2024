"""The newest samples of every robot, for a target that moves: what is passed on, and what a track is made of.

A sample may arrive late and out of order, over other robots. One that comes after its moment has left the window
(fixed_lag_filter.py) is of no use any more, neither here nor to a neighbour.

Clocks need not agree. A sample carries its age; every robot that passes it on adds the time it lay there, and the
mailbox adds the time it lay in a queue. It also carries when it was taken on its origin's clock, which no relay can
change: what we learn of that clock from one sample holds for the next (origin_clocks.py).
"""

from __future__ import annotations

from collections.abc import Collection

from agent.core.estimation.evidence_checks import Bounds, sample_fault
from agent.core.estimation.fixed_lag_filter import Held
from agent.core.messages import Holding, Sample
from agent.core.origin_clocks import OriginClocks
from agent.core.savepoint import Revertible

Key = tuple[str, int, int]  # origin, incarnation, number

WINDOW = 24  # length in iterations: the way across a swarm of some ten hops when a third of all messages is lost
KEPT = 48  # samples of one robot, those with the largest numbers: twice what an honest one has in a window
MASK = 32  # samples before the newest that one line of a digest can tell of; more than a window holds


class Window(Revertible):
    """All samples of one epoch of one target that can still matter."""

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._span_ns = WINDOW * bounds.iteration_ns
        self.samples: dict[Key, Held] = {}
        self._clocks = OriginClocks()
        self._frozen_ns = -(10**30)  # samples up to this moment are in the frozen tracks, or too late

    def measure(self, key: Key, held: Held) -> None:
        """Add a sample of our own."""
        if held.t_ns > self._frozen_ns:
            self.samples[key] = held

    def fault(self, sample: Sample, arrived_ns: int) -> str | None:
        """Why a sample that left its sender at `arrived_ns` of our clock is of no use, whoever says it."""
        fault = sample_fault(sample, self._bounds, arrived_ns)
        if fault is None and arrived_ns - sample.age_ns <= self._frozen_ns:
            return "too late"
        return fault

    def earlier(self, sample: Sample, arrived_ns: int) -> None:
        """The same sample over another way. Only where its origin's clock was not told the age decides."""
        key, t_ns = (sample.origin, sample.incarnation, sample.number), arrived_ns - sample.age_ns
        old = self.samples[key]
        if not old.exposed_ns and self._frozen_ns < t_ns < old.t_ns:
            self.samples[key] = old._replace(t_ns=t_ns)

    def merge(self, sample: Sample, arrived_ns: int, direct: bool) -> str | None:
        """Take in a sample that is believed; returns why it is of no use, if it is not. direct: from its own robot."""
        t_ns = arrived_ns - sample.age_ns
        if sample.t_ns:
            offset_ns = self._clocks.offset_ns(sample.origin, t_ns - sample.t_ns, direct, arrived_ns)
            t_ns = min(sample.t_ns + offset_ns, arrived_ns)
        if t_ns <= self._frozen_ns:
            return "too late"
        key = (sample.origin, sample.incarnation, sample.number)
        self.samples[key] = Held(t_ns, sample.information, sample.vector, sample.t_ns, sample.signature)
        numbers = sorted(k for k in self.samples if k[0] == sample.origin)
        for old in numbers[:-KEPT]:
            del self.samples[old]
        return None

    def drop(self, origins: Collection[str]) -> None:
        """Nothing of these counts any more."""
        self.samples = {key: held for key, held in self.samples.items() if key[0] not in origins}

    def fresh(self) -> dict[str, list[Held]]:
        """Samples of each origin since the horizon, in the order of their names and numbers."""
        found: dict[str, list[Held]] = {}
        for key in sorted(self.samples):
            if self.samples[key].t_ns > self._frozen_ns:
                found.setdefault(key[0], []).append(self.samples[key])
        return found

    def horizon_ns(self, now_ns: int) -> int:
        """Where the window begins."""
        return now_ns - self._span_ns

    def freeze(self, horizon_ns: int) -> None:
        """The window begins here from now on; what is older has its place in the tracks."""
        self._frozen_ns = max(self._frozen_ns, horizon_ns)
        # Frozen samples stay listed for another window: neighbours that still hold them must not send them again.
        oldest_ns = horizon_ns - self._span_ns
        self.samples = {key: held for key, held in self.samples.items() if held.t_ns > oldest_ns}

    def sendable(self, now_ns: int) -> dict[Key, int]:
        """Samples that a neighbour may still use, newest first."""
        fresh = [key for key, held in self.samples.items() if held.t_ns > self.horizon_ns(now_ns)]
        return {key: 1 for key in sorted(fresh, key=lambda key: (-self.samples[key].t_ns, key))}

    def sample(self, key: Key, now_ns: int) -> Sample:
        """A sample as it leaves now."""
        held = self.samples[key]
        age_ns = max(0, now_ns - held.t_ns)
        return Sample(*key, age_ns, held.information, held.vector, held.exposed_ns, held.signature)

    def digest(self) -> list[Holding]:
        """One line for each origin and incarnation."""
        numbers: dict[tuple[str, int], list[int]] = {}
        for origin, incarnation, number in sorted(self.samples):
            numbers.setdefault((origin, incarnation), []).append(number)
        return [
            Holding(*who, held[-1], sum(1 << (held[-1] - 1 - k) for k in held[:-1] if held[-1] - 1 - k < MASK))
            for who, held in numbers.items()
        ]
