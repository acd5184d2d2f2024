"""Follow a thing that somebody has drawn a box around, say when it is lost, and find it again.

Two witnesses have to agree: the tracker's own score, and the likeness of what is in its box to what was there before.
Either alone is fooled: the score recovers on an empty wall, the likeness falls when a fish turns. A box that grew,
shrank or jumped more than a thing can within one frame is not believed either. While it is lost the whole picture is
searched for it, and the tracker starts anew where it is found.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.kernel.config import ConfigError
from agent.perception.tracking.appearance import (
    ANY_SCALE,
    NEAR_SCALES,
    Appearance,
    Box,
    Image,
    likeness,
    remember,
    renewed,
    search,
)
from agent.perception.tracking.box_trackers import BoxTracker

HOLD_SCORE, SURE_SCORE = 0.60, 0.75  # NanoTrack gives 0.85 to 0.93 while its target is there
HOLD_LIKE, SURE_LIKE = 0.50, 0.60  # measured: 0.57 to 0.95 from frame to frame, to 0.45 when something else is there
FOUND_LIKE = 0.60  # best place in a picture without the thing: 0.2 to 0.45
FIRST_LIKE = 0.70  # the same in any size: 0.58 in one of ten, grey stone before a grey floor; with the thing 0.6 to 1
MAX_GROWTH = 1.5  # of the area, from frame to frame
MAX_STEP = 1.0  # of the box's diagonal, from frame to frame
MIN_SIDE_PX = 8  # of a box that can be followed


class Followed(NamedTuple):
    box: Box  # while it is lost: where it was last seen
    score: float  # 0 to 1, the weaker witness; 0 while it is lost
    lost: bool


class Follower:
    """Give it every frame of one size; it begins to follow at start(), or to look around at expect()."""

    def __init__(self, tracker: BoxTracker) -> None:
        self._tracker = tracker
        self._appearance: Appearance | None = None
        self._box = Box(0, 0, 0, 0)
        self._lost = True
        self._seen = False

    def expect(self, picture: Image, box: Box) -> None:
        """Look for what is in this box of another picture: it may be anywhere, and nearer or farther. Raises
        ConfigError as start() does."""
        check_box(box, (picture.shape[1], picture.shape[0]))
        self._appearance, self._box, self._lost, self._seen = remember(picture, box), box, True, False

    def start(self, image: Image, box: Box) -> None:
        """Follow what is in this box from now on. Raises ConfigError for one that is not in the picture."""
        check_box(box, (image.shape[1], image.shape[0]))
        self._tracker.start(image, box)
        self._appearance, self._box, self._lost = remember(image, box), box, False
        self._seen = True

    def look(self, image: Image) -> Followed:
        """Where it is in the next picture. Raises RuntimeError before start() or expect()."""
        if self._appearance is None:
            raise RuntimeError("call start() or expect() before look()")
        return self._search(image, self._appearance) if self._lost else self._follow(image, self._appearance)

    def _follow(self, image: Image, appearance: Appearance) -> Followed:
        box, score = self._tracker.follow(image)
        alike = likeness(appearance, image, box) if usable(box) and steady(self._box, box) else -1.0
        if score < HOLD_SCORE or alike < HOLD_LIKE:
            self._lost = True
            return self._search(image, appearance)  # it may have jumped
        self._box = box
        if score >= SURE_SCORE and alike >= SURE_LIKE:
            self._appearance = renewed(appearance, image, box)
        return Followed(box, min(score, max(alike, 0.0)), lost=False)

    def _search(self, image: Image, appearance: Appearance) -> Followed:
        box, alike = search(appearance, image, self._box, NEAR_SCALES if self._seen else ANY_SCALE)
        if alike < (FOUND_LIKE if self._seen else FIRST_LIKE):
            return Followed(self._box, 0.0, lost=True)
        self._tracker.start(image, box)
        self._box, self._lost, self._seen = box, False, True
        return Followed(box, alike, lost=False)


def usable(box: Box) -> bool:
    return min(box.width, box.height) >= MIN_SIDE_PX


def steady(before: Box, after: Box) -> bool:
    """Whether one and the same thing can have had these boxes in two frames that follow each other."""
    growth = after.width * after.height / (before.width * before.height)
    step = math.dist(before.centre_px, after.centre_px) / math.hypot(before.width, before.height)
    return 1.0 / MAX_GROWTH <= growth <= MAX_GROWTH and step <= MAX_STEP


def parse_box(text: str) -> Box:
    """X,Y,W,H in pixels. Raises ConfigError."""
    try:
        box = Box(*(float(side) for side in text.split(",")))
    except (TypeError, ValueError):
        raise ConfigError(f"--box {text}: write four numbers X,Y,W,H, pixels from the upper left corner") from None
    if not all(math.isfinite(side) for side in box):
        raise ConfigError(f"--box {text}: not finite; write four numbers X,Y,W,H")
    return box


def check_box(box: Box, size: tuple[int, int]) -> None:
    """Raises ConfigError for a box too small to follow or not inside a picture of size (width, height)."""
    inside = box.x >= 0 and box.y >= 0 and box.x + box.width <= size[0] and box.y + box.height <= size[1]
    if not inside or not usable(box):
        raise ConfigError(
            f"box {','.join(f'{side:g}' for side in box)}: draw it inside the {size[0]}x{size[1]} picture, "
            f"at least {MIN_SIDE_PX} pixels wide and high"
        )
