"""The parts of a frame that count: what to read of the next one, and what clarity is taken over.

Clarity is taken well inside a target: its silhouette is sharp at another lens position than its skin, and what is
behind it at a third.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import INNER_DISC
from agent.perception.clarity.clarity import tenengrad_disc, tenengrad_grid
from hw.camera.camera import Frame, Roi

INNER_BOX = 0.5  # share of a box's width and height: a thing rarely fills the corners of its box
ROI_MARGIN = 1.15  # of the ball's radius, and
ROI_BORDER_PX = 24  # the blur at the end of a tracking sweep

Clarity = tuple[float | None, float | None]  # per pixel, and over how many; None where the frame shows none of it
UNSEEN: Clarity = (None, None)


class Sized(Protocol):
    """What was found: as large as a box, or as a ball."""

    @property
    def size_px(self) -> tuple[float, float] | None: ...
    @property
    def radius_px(self) -> float | None: ...


def around(centre_px: tuple[float, float] | None, radius_px: float | None, size: tuple[int, int]) -> Roi | None:
    """The part of a frame that holds a ball, its outline's blur and a little motion; None: the whole frame.

    What is no ball has no radius, and a tracker compares whole frames.
    """
    if centre_px is None or radius_px is None:
        return None
    half = ROI_MARGIN * radius_px + ROI_BORDER_PX
    left, top = (max(0, int(c - half)) for c in centre_px)
    right, bottom = (min(s, int(c + half) + 1) for c, s in zip(centre_px, size, strict=True))
    if left + 16 > right or top + 16 > bottom or (right - left, bottom - top) == size:
        return None
    return Roi(left, top, right - left, bottom - top)


def prepare() -> None:
    """Load the compiled code now, for 0.3 s of a core, and not while somebody waits for what a first frame shows."""
    frame = Frame(0, 0, np.zeros((16, 16, 3), np.uint8), Roi(0, 0, 16, 16))
    disc_clarity(frame, (8.0, 8.0), 8.0)
    box_clarity(frame, (8.0, 8.0), (16.0, 16.0))


def disc_clarity(frame: Frame, centre_px: tuple[float, float], radius_px: float) -> Clarity:
    """Clarity of the raw luminance on a ball's inner disc."""
    x, y, radius = centre_px[0] - frame.roi.x, centre_px[1] - frame.roi.y, INNER_DISC * radius_px
    left, top = max(0, int(x - radius) - 2), max(0, int(y - radius) - 2)
    part: NDArray[np.uint8] = frame.image[top : int(y + radius) + 4, left : int(x + radius) + 4]
    if min(part.shape[:2]) < 3:
        return UNSEEN
    clarity, area_px = tenengrad_disc(part, (x - left, y - top), radius)
    return (clarity, area_px) if area_px else UNSEEN


def box_clarity(frame: Frame, centre_px: tuple[float, float], size_px: tuple[float, float]) -> Clarity:
    """Clarity of the raw luminance on the inner part of a box, as far as the frame shows it; whole pixels."""
    (left, right), (top, bottom) = (
        _span(centre - start, INNER_BOX * side, length)
        for centre, start, side, length in zip(
            centre_px, frame.roi[:2], size_px, (frame.image.shape[1], frame.image.shape[0]), strict=True
        )
    )
    if min(right - left, bottom - top) < 3:
        return UNSEEN
    clarity = tenengrad_grid(frame.image, np.array([top, bottom]), np.array([left, right]))
    return float(clarity[0, 0]), float((right - left) * (bottom - top))


def target_clarity(frame: Frame, centre_px: tuple[float, float], found: Sized, first: Sized | None) -> Clarity:
    """Clarity over a part as large as in the sweep's first frame: areas stay comparable while the blur changes."""
    if found.size_px is not None:
        return box_clarity(frame, centre_px, (first and first.size_px) or found.size_px)
    assert found.radius_px is not None  # a ball
    return disc_clarity(frame, centre_px, (first and first.radius_px) or found.radius_px)


def _span(middle: float, length: float, limit: int) -> tuple[int, int]:
    """First pixel and the one behind the last, of `length` around `middle`, within 0 to `limit`."""
    first = round(middle + 0.5 - length / 2)
    return max(0, first), min(limit, first + round(length))
