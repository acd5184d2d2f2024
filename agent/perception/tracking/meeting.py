"""A thing and a look-alike that have become one in the picture, and in which place each of them is afterwards.

A tracker may leave a meeting with either, or grow over both. What tells them apart is how each moved before: it goes on
as it went, the more surely the slower it was. Limits were chosen on buoys that pass their double, or turn round at it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.perception.tracking.box import Box, same
from agent.perception.tracking.motion import Motion

TREMBLE = 0.2  # of the diagonal: how far even what stands still is off
TURN = 0.75  # of the way that it would have gone: it may have stopped, or turned
REACH = 4.0  # standard deviations: farther off it is a third one
CLEAR = 4.0  # by so much one reading's squared deviations are less than another's: odds of e to the 2
APART = 30  # frames for which two places have been seen: from then on the better reading is taken, clear or not


class Meeting(NamedTuple):
    thing: Motion  # as it was before
    other: Motion
    frames: int = 1  # since then
    apart: int = 0  # of these, in which two places were seen

    def next(self, apart: bool) -> Meeting:
        """One frame later, in which two places were seen or one."""
        return self._replace(frames=self.frames + 1, apart=self.apart + apart)

    def reaches(self, box: Box) -> bool:
        """Whether what is in this box can be one of the two."""
        return any(self._off(motion, box) <= REACH**2 for motion in (self.thing, self.other))

    def parted(self, boxes: Sequence[Box]) -> tuple[Box, Box] | None:
        """Where the thing is and where the other is, of places that are like them; None where nobody can tell yet: one
        of the two may be behind the other."""
        readings = sorted(
            (self._off(self.thing, mine) + self._off(self.other, its), mine, its)
            for mine, its in itertools.permutations(boxes, 2)
            if not same(mine, its)
        )
        if not readings:
            return None
        best, mine, its = readings[0]
        second = next(off for off, place, _ in readings if place != mine)  # there is one: the two swapped
        return (mine, its) if second - best >= CLEAR or self.apart >= APART else None

    def _off(self, motion: Motion, box: Box) -> float:
        """Squared, in standard deviations, from where it would be by now."""
        frames = self.frames + motion.unseen
        way = motion.step_px[0] * frames, motion.step_px[1] * frames
        sigma_px = TREMBLE * math.hypot(motion.box.width, motion.box.height) + TURN * math.hypot(*way)
        return (math.dist(motion.box.moved(*way).centre_px, box.centre_px) / sigma_px) ** 2
