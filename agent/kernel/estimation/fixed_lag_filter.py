"""A Kalman filter over samples that come late and out of order: frozen where the window begins, run again from there.

What comes out is the filter of somebody who had every sample in time, as long as none is later than the window is
long. What is older than the window stays as one track, whose worth fades with the acceleration noise.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from agent.kernel.estimation.track import Track, begin, correct, predict, summed
from agent.kernel.messages import Symmetric, Vector


class Held(NamedTuple):
    """One sample as this robot keeps it."""

    t_ns: int  # of exposure, on this robot's clock
    information: Symmetric  # R^-1, 1/m^2
    vector: Vector  # R^-1 x̂, 1/m
    exposed_ns: int = 0  # of exposure, on the clock of its origin; 0: not told
    signature: bytes = b""


class FixedLagFilter:
    """A track over the samples that it is shown; those up to the horizon it remembers, the others it must see again."""

    def __init__(self) -> None:
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
                track = begin(t_ns, information, vector)
            else:
                track = correct(predict(track, t_ns), information, vector)
            if t_ns <= horizon_ns:
                self._frozen = track
        return None if track is None else predict(track, now_ns)
