"""Things that are like the one that is followed, and are not it: each is where one was in the frame before.

While a thing is followed, what looks like it near by is not it, and when it is lost, neither is whatever else in that
frame looks like it: it was too far away. These others are followed, roughly, from frame to frame; what comes up where
none of them can be may be the thing itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.perception.tracking.box import Box, same

STEP = 0.5  # of the diagonal: how far one goes from frame to frame
SPREAD = 0.1  # of the diagonal, for each frame in which it did not show
KEPT = 30  # frames for which one that does not show is remembered: 1 s


class LookAlike(NamedTuple):
    box: Box
    unseen: int = 0  # frames

    def explains(self, box: Box) -> bool:
        """Whether what is in this box can be this one."""
        reach = (STEP + SPREAD * self.unseen) * math.hypot(self.box.width, self.box.height)
        return math.dist(self.box.centre_px, box.centre_px) <= reach


def explained(others: Sequence[LookAlike], box: Box) -> bool:
    return any(other.explains(box) for other in others)


def followed(others: Sequence[LookAlike], boxes: Sequence[Box]) -> list[LookAlike]:
    """The same ones in the next frame, in which `boxes` are like the thing and are not it."""
    now = [LookAlike(box) for box in boxes]
    missing = [
        other._replace(unseen=other.unseen + 1)
        for other in others
        if other.unseen < KEPT and not any(other.explains(box) for box in boxes)
    ]
    return now + missing


def merged(others: Sequence[LookAlike], box: Box) -> bool:
    """Whether one of them went out of sight where this box is: in the picture they are one."""
    return any(other.unseen and same(other.box, box) for other in others)
