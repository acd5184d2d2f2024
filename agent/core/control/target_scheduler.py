"""Which of several targets the camera looks at.

A camera looks at one target at a time, and only the target that is looked at iterates. The rule: a turn lasts until the
target's iteration index passes a multiple of TURN; then the target with the lowest index is next, in the order of the
fleet file where they are equal. The index is one that all robots of a swarm share (a robot that is behind adopts that
of its neighbours), so all of them look at the same target at the same time, from their different sides, without having
to ask: each target's valid set is as large as it can be.

What nobody has seen yet has its turns like the others; the camera then rests where the fleet file's `look` points.

No target starves. A turn ends after TURN iterations, whatever the camera sees. And should indices that come from
elsewhere keep a target from ever being the lowest (a neighbour that knows one target only drives that one), who has
been passed over for PATIENCE turns of each of the others is next.
"""

from __future__ import annotations

from collections.abc import Mapping

from agent.core.savepoint import Revertible

TURN = 5  # iterations: one goes by while the gimbal turns, and a search looks in two directions
PATIENCE = 2


class TargetScheduler(Revertible):
    """Whose turn it is."""

    def __init__(self, targets: tuple[str, ...]) -> None:
        """There must be a target. The first has the first turn."""
        self.target = targets[0]
        self._waits = dict.fromkeys(targets, 0)  # turns of others since its own; keys in the order of the fleet file
        self._ends_at = TURN

    def next(self, t: Mapping[str, int], pursued: str | None = None) -> str:
        """Whose turn it is now; asked when no measurement is under way. `t`: the iteration index of each target.
        pursued: a target that the camera goes with, and takes no turns meanwhile."""
        if pursued is not None:
            self.target = pursued
        if pursued is not None or len(self._waits) == 1 or t[self.target] < self._ends_at:
            return self.target
        longest = max(self._waits, key=lambda name: self._waits[name])  # the first of equals
        overdue = self._waits[longest] > PATIENCE * (len(self._waits) - 1)
        self.target = longest if overdue else min(self._waits, key=lambda name: t[name])
        self._waits = {name: 0 if name == self.target else waited + 1 for name, waited in self._waits.items()}
        self._ends_at = (t[self.target] // TURN + 1) * TURN
        return self.target
