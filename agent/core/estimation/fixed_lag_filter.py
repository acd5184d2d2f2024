"""A Kalman filter over samples that come late and out of order: frozen where the window begins, run again from there.

What comes out is the filter of somebody who had every sample in time, as long as none is later than the window is
long. What is older than the window stays as one track, whose worth fades with the acceleration noise.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from agent.core.estimation.dynamics import ROLLING, Dynamics
from agent.core.estimation.line import placed
from agent.core.estimation.track import Track, begin, correct, predict, summed
from agent.core.matrix import well_conditioned
from agent.core.messages import Symmetric, Vector
from agent.core.savepoint import Revertible

ANYWHERE_M = (10.0, 10.0, 10.0)  # where nobody says how large the tank is


class Held(NamedTuple):
    """One sample as this robot keeps it."""

    t_ns: int  # of exposure, on this robot's clock
    information: Symmetric  # R^-1, 1/m^2; of rank 2 at least
    vector: Vector  # R^-1 x̂, 1/m
    exposed_ns: int = 0  # of exposure, on the clock of its origin; 0: not told
    signature: bytes = b""


class FixedLagFilter(Revertible):
    """A track over the samples that it is shown; those up to the horizon it remembers, the others it must see again.

    tank_m: where the target is for certain, which is all that a first bearing knows of the way along it.
    """

    def __init__(self, dynamics: Dynamics = ROLLING, tank_m: Vector = ANYWHERE_M) -> None:
        self._dynamics, self._tank_m = dynamics, tank_m
        self._frozen: Track | None = None

    def run(self, samples: Iterable[Held], horizon_ns: int, now_ns: int) -> Track | None:
        """The filter at this moment; None before the first sample.

        samples: all that are newer than the horizon of the run before, in an order that is the same on every robot.
        """
        moments: dict[int, list[tuple[Symmetric, Vector]]] = {}
        for held in samples:
            moments.setdefault(held.t_ns, []).append((held.information, held.vector))
        track = self._frozen
        for t_ns in sorted(moments):
            information, vector = summed(moments[t_ns])
            if track is None:
                if not well_conditioned(information):
                    information, vector = placed(information, vector, self._tank_m)
                track = begin(t_ns, information, vector, self._dynamics)
            else:
                track = correct(predict(track, t_ns, self._dynamics), information, vector)
            if t_ns <= horizon_ns:
                self._frozen = track
        return None if track is None else predict(track, now_ns, self._dynamics)
