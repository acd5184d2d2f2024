"""Where a followed thing can be in the next frame, and how far it can have gone while nobody saw it."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.perception.tracking.box import Box

FRESH = 0.3  # weight of the newest step in the speed
MAX_STEP = 0.5  # of the sides: its middle stays in the box in which it was expected; turning goldfish have 0.25
FIRST_REACH = 0.6  # of the diagonal: how far from there something lost may be in the next frame
MAX_GROWTH = 1.5  # of the area, from frame to frame
MOTION_SPREAD = 0.25  # of the diagonal: by so much more for each frame in which it was not seen
COASTS = 5  # frames for which an unseen thing is expected to keep its speed


class Motion(NamedTuple):
    """A thing that goes on as it went: constant speed, in frames because frames are all that a follower gets."""

    box: Box  # where it was last seen
    step_px: tuple[float, float] = (0.0, 0.0)  # across, down, from frame to frame
    unseen: int = 0  # frames

    def seen(self, box: Box, fresh: float = FRESH) -> Motion:
        """It is in this box now; its newest step has the weight `fresh`."""
        steps = [
            (now - before) / (self.unseen + 1) for now, before in zip(box.centre_px, self.box.centre_px, strict=True)
        ]
        across, down = (fresh * new + (1.0 - fresh) * old for new, old in zip(steps, self.step_px, strict=True))
        return Motion(box, (across, down))

    def missed(self) -> Motion:
        """It is not seen in this frame."""
        return self._replace(unseen=self.unseen + 1)

    @property
    def expected(self) -> Box:
        """Where it should be in the next frame."""
        frames = min(self.unseen + 1, COASTS)
        return self.box.moved(self.step_px[0] * frames, self.step_px[1] * frames)

    @property
    def reach_px(self) -> float:
        """How far from there its middle can be."""
        diagonal = math.hypot(self.box.width, self.box.height)
        return (FIRST_REACH + MOTION_SPREAD * self.unseen) * diagonal + math.hypot(*self.step_px) * self.unseen

    def reaches(self, box: Box) -> bool:
        return math.dist(self.expected.centre_px, box.centre_px) <= self.reach_px

    def allows(self, box: Box) -> bool:
        """Whether one and the same thing can have this box in the next frame."""
        growth = box.area_px / self.box.area_px
        across, down = (now - then for now, then in zip(box.centre_px, self.expected.centre_px, strict=True))
        stays = abs(across) <= MAX_STEP * self.box.width and abs(down) <= MAX_STEP * self.box.height
        return 1.0 / MAX_GROWTH <= growth <= MAX_GROWTH and stays
