"""Does a box still show what it showed when somebody drew it, and if not, where in the picture is that now?

A siamese tracker always answers: when its target leaves, it settles on whatever is there, and soon with the same
score as before. So it is checked by something that knows nothing of it: the correlation of small pictures (colour and
a rim of surroundings, so that an outline counts) with the one that was drawn and with the newest that was certain.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]  # (height, width, 3), blue green red

PATCH_PX = 24  # longer side of the small pictures: a defocused thing still looks like itself
RIM = 1.3  # of the box is in the picture
PLAY = 0.15  # of the box: how far a good box may be off
NEAR_SCALES = (0.8, 1.0, 1.25)  # in which a lost thing is looked for: it may have come nearer or gone away
ANY_SCALE = (0.5, 0.64, 0.8, 1.0, 1.25, 1.56, 1.95)  # and one that has not been seen yet


class Box(NamedTuple):
    """A region of a frame, pixels from the outer corner of its upper left one."""

    x: float
    y: float
    width: float
    height: float

    @property
    def centre_px(self) -> tuple[float, float]:
        """(u, v) from the centre of the upper left pixel, as every other pixel position."""
        return self.x + self.width / 2 - 0.5, self.y + self.height / 2 - 0.5

    def grown(self, factor: float) -> Box:
        width, height = self.width * factor, self.height * factor
        return Box(self.x - (width - self.width) / 2, self.y - (height - self.height) / 2, width, height)


class Appearance(NamedTuple):
    """What is remembered of a thing: pictures (h, w, 3), longer side PATCH_PX, of its box and a rim."""

    first: Image
    newest: Image


def remember(image: Image, box: Box) -> Appearance:
    patch = _cut(image, box.grown(RIM), _size(box))
    return Appearance(patch, patch)


def renewed(appearance: Appearance, image: Image, box: Box) -> Appearance:
    """The same thing, but the newest picture is that of `box`."""
    return appearance._replace(newest=_cut(image, box.grown(RIM), _shape(appearance)))


def likeness(appearance: Appearance, image: Image, box: Box) -> float:
    """Correlation of what is in the box with what is remembered, -1 to 1, best over a little shift."""
    width, height = _shape(appearance)
    play = 1.0 + 2.0 * PLAY / RIM
    size = round(width * play), round(height * play)
    here = _cut(image, box.grown(RIM * play), size)
    return max(float(_correlate(here, patch).max()) for patch in patches_of(appearance))


def search(
    appearance: Appearance, image: Image, last: Box, scales: tuple[float, ...] = NEAR_SCALES
) -> tuple[Box, float]:
    """Where in the whole picture something is most like what is remembered, and how much; `scales` times as large as
    `last`.

    Where the picture is smaller than the thing, the answer is `last`, with -1.
    """
    best, found = -1.0, last
    width, height = _shape(appearance)
    beyond = [round(side * (1.0 - 1.0 / RIM) / 2.0) for side in (width, height)]  # of a box at the border, its rim
    for scale in scales:
        shrink = width / (last.width * RIM * scale)
        size = round(image.shape[1] * shrink), round(image.shape[0] * shrink)
        if size[0] + 2 * beyond[0] <= width or size[1] + 2 * beyond[1] <= height:
            continue
        small = cv2.resize(image, size, interpolation=_interpolation(shrink))
        wide = cv2.copyMakeBorder(small, beyond[1], beyond[1], beyond[0], beyond[0], cv2.BORDER_REPLICATE)
        for patch in patches_of(appearance):
            _, alike, _, (x, y) = cv2.minMaxLoc(_correlate(np.asarray(wide, np.uint8), patch))
            if alike > best:
                best = float(alike)
                corner = (x - beyond[0]) / shrink, (y - beyond[1]) / shrink
                found = Box(*corner, width / shrink, last.height * RIM * scale).grown(1.0 / RIM)
    return found, best


def patches_of(appearance: Appearance) -> tuple[Image, ...]:
    return (appearance.first,) if appearance.first is appearance.newest else tuple(appearance)


def _size(box: Box) -> tuple[int, int]:
    longer = max(box.width, box.height)
    return max(4, round(PATCH_PX * box.width / longer)), max(4, round(PATCH_PX * box.height / longer))


def _shape(appearance: Appearance) -> tuple[int, int]:
    return appearance.first.shape[1], appearance.first.shape[0]


def _cut(image: Image, box: Box, size: tuple[int, int]) -> Image:
    """A part of a picture, resampled to size (width, height); beyond the picture its border goes on."""
    left, top, right, bottom = round(box.x), round(box.y), round(box.x + box.width), round(box.y + box.height)
    rows = np.clip(np.arange(top, max(bottom, top + 1)), 0, image.shape[0] - 1)
    columns = np.clip(np.arange(left, max(right, left + 1)), 0, image.shape[1] - 1)
    part = image[rows[:, None], columns[None, :]]
    return np.asarray(cv2.resize(part, size, interpolation=_interpolation(size[0] / part.shape[1])), np.uint8)


def _interpolation(factor: float) -> int:
    return cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR


def _correlate(image: Image, patch: Image) -> NDArray[np.float32]:
    """-1 to 1 for every place of the patch in the image; each colour's mean is taken off first."""
    found = np.asarray(cv2.matchTemplate(image, patch, cv2.TM_CCOEFF_NORMED), np.float32)
    return np.nan_to_num(np.clip(found, -1.0, 1.0), nan=-1.0)
