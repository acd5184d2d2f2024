"""A box in a picture, and what of a picture lies in it."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]  # (height, width, 3), blue green red

SAME_SHARE = 0.5  # of the smaller box that lies in the larger: they are one place


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

    @property
    def area_px(self) -> float:
        return self.width * self.height

    def grown(self, factor: float) -> Box:
        """Of `factor` times the sides, about the same middle."""
        width, height = self.width * factor, self.height * factor
        return Box(self.x - (width - self.width) / 2, self.y - (height - self.height) / 2, width, height)

    def moved(self, across_px: float, down_px: float) -> Box:
        return self._replace(x=self.x + across_px, y=self.y + down_px)

    def inside(self, size: tuple[int, int]) -> Box:
        """What of it lies in a picture of (width, height); a side is 0 where nothing does."""
        left, top = max(self.x, 0.0), max(self.y, 0.0)
        right, bottom = min(self.x + self.width, size[0]), min(self.y + self.height, size[1])
        return Box(left, top, max(right - left, 0.0), max(bottom - top, 0.0))


def common_px(a: Box, b: Box) -> float:
    """Area that lies in both, pixels."""
    width = min(a.x + a.width, b.x + b.width) - max(a.x, b.x)
    height = min(a.y + a.height, b.y + b.height) - max(a.y, b.y)
    return max(width, 0.0) * max(height, 0.0)


def overlap(a: Box, b: Box) -> float:
    """Intersection over union, 0 to 1."""
    both = common_px(a, b)
    return both / (a.area_px + b.area_px - both) if both else 0.0


def same(a: Box, b: Box) -> bool:
    """Whether two boxes show one thing, if not its whole."""
    return common_px(a, b) >= SAME_SHARE * min(a.area_px, b.area_px)


def uncut(box: Box, whole: Box, size: tuple[int, int]) -> Box:
    """The box as it would be without the picture's border, at which trackers cut it: as large as when it was whole."""
    x, y, width, height = box
    if (x <= 1) != (x + width >= size[0] - 1) and whole.width > width:
        x, width = (x + width - whole.width if x <= 1 else x), whole.width
    if (y <= 1) != (y + height >= size[1] - 1) and whole.height > height:
        y, height = (y + height - whole.height if y <= 1 else y), whole.height
    return Box(x, y, width, height)


def cut(image: Image, box: Box, size: tuple[int, int]) -> Image:
    """What a box shows, resampled to size (width, height); beyond the picture its border goes on."""
    left, top = round(box.x), round(box.y)
    right, bottom = max(round(box.x + box.width), left + 1), max(round(box.y + box.height), top + 1)
    height, width = image.shape[:2]
    rows = slice(min(max(top, 0), height - 1), max(min(bottom, height), 1))
    columns = slice(min(max(left, 0), width - 1), max(min(right, width), 1))
    part = image[rows, columns]
    if (bottom - top, right - left) != part.shape[:2]:
        missing_rows, missing_columns = bottom - top - part.shape[0], right - left - part.shape[1]
        above, before = min(max(-top, 0), missing_rows), min(max(-left, 0), missing_columns)
        below, after = missing_rows - above, missing_columns - before
        part = np.asarray(cv2.copyMakeBorder(part, above, below, before, after, cv2.BORDER_REPLICATE), np.uint8)
    shrinks = size[0] < part.shape[1]
    return np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR), np.uint8)
