"""The newest samples of every robot, for a target that moves: what is passed on, and what a track is made of.

A sample may arrive late and out of order, over other robots. One that comes after its moment has left the window
(fixed_lag_filter.py) is of no use any more, neither here nor to a neighbour.

Clocks need not agree. A sample carries its age; every robot that passes it on adds the time it lay there, and the
mailbox adds the time it lay in a queue. The copy that says "longest ago" is the one with least of its way unaccounted.
"""

from __future__ import annotations

from agent.kernel.estimation.evidence_checks import Bounds, sample_fault
from agent.kernel.estimation.fixed_lag_filter import Held
from agent.kernel.messages import Holding, Sample

Key = tuple[str, int, int]  # origin, incarnation, number

WINDOW = 24  # length in iterations: the way across a swarm of some ten hops when a third of all messages is lost
MASK = 32  # samples before the newest that one line of a digest can tell of; more than a window holds


class Window:
    """All samples of one epoch of one target that can still matter."""

    def __init__(self, bounds: Bounds) -> None:
        self._bounds = bounds
        self._span_ns = WINDOW * bounds.iteration_ns
        self.samples: dict[Key, Held] = {}
        self._frozen_ns = -(10**30)  # samples up to this moment are in the frozen tracks, or too late

    def measure(self, key: Key, held: Held) -> None:
        """Add a sample of our own."""
        if held.t_ns > self._frozen_ns:
            self.samples[key] = held

    def merge(self, sample: Sample, arrived_ns: int) -> tuple[bool, str | None]:
        """Take in a sample that left its sender at `arrived_ns` of our clock: (whether it was news, why refused)."""
        fault = sample_fault(sample, self._bounds)
        if fault is not None:
            return False, fault
        key, t_ns = (sample.origin, sample.incarnation, sample.number), arrived_ns - sample.age_ns
        old = self.samples.get(key)
        if old is not None:
            if self._frozen_ns < t_ns < old.t_ns:
                self.samples[key] = old._replace(t_ns=t_ns)
            return False, None
        if t_ns <= self._frozen_ns:
            return False, "too late"
        self.samples[key] = Held(t_ns, sample.information, sample.vector)
        return True, None

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
        return Sample(*key, max(0, now_ns - held.t_ns), held.information, held.vector)

    def digest(self) -> list[Holding]:
        """One line for each origin and incarnation."""
        numbers: dict[tuple[str, int], list[int]] = {}
        for origin, incarnation, number in sorted(self.samples):
            numbers.setdefault((origin, incarnation), []).append(number)
        return [
            Holding(*who, held[-1], sum(1 << (held[-1] - 1 - k) for k in held[:-1] if held[-1] - 1 - k < MASK))
            for who, held in numbers.items()
        ]
