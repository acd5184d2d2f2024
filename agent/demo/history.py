"""What the robots of a demo showed, by target and robot."""

from __future__ import annotations

from typing import NamedTuple

from agent.core.messages import State, Vector


class History(NamedTuple):
    """What one robot showed about one target, newest last."""

    states: list[State]

    @property
    def newest(self) -> State | None:
        """The last state, if there is one."""
        return self.states[-1] if self.states else None

    def iterations(self) -> list[State]:
        """The last state of each iteration."""
        by_t = {state.t: state for state in self.states}
        return [by_t[t] for t in sorted(by_t)]

    def priors(self) -> list[Vector]:
        """Each measurement once."""
        by_number = {s.measurements: s.prior_m for s in self.states if s.prior_m is not None}
        return [by_number[n] for n in sorted(by_number)]


Histories = dict[str, dict[str, History]]  # by target, then by robot
