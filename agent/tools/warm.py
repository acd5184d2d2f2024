"""Whether warm colours stay warm: of the pixels that are red to yellow and vivid, how many still are.

A red buoy that comes out olive costs a picture hardly a tenth of a decibel, and its finder everything. Hue and chroma
are CIELAB's. Pictures are (height, width, 3) uint8, blue green red.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

WARM_DEG = (0.0, 110.0)  # hue: sRGB's red lies at 40 degrees, orange at 70, yellow at 103; crimson is the lower end
VIVID = 30.0  # chroma from which a colour is vivid: sand and rock of 108 real references have less, but for 1 %
PALE = 10.0  # chroma below which nothing is left of it
NEAR_DEG = 25.0  # hue may move by: half of the way from red to yellow is 30


class Kept(NamedTuple):
    """Of `pixels` that are warm and vivid, `kept` are still warm."""

    pixels: int
    kept: int


def kept_hue(image: Image, reference: Image) -> Kept:
    """Kept: some chroma is left, and the hue lies within NEAR_DEG of the reference's."""
    hue, chroma = _hue_chroma(image)
    wanted, _ = _hue_chroma(reference)
    where = warm(reference)
    apart = np.abs((hue - wanted + 180) % 360 - 180)
    return _count(where, (apart <= NEAR_DEG) & (chroma >= PALE))


def kept_warm(image: Image, before: Image, where: Mask) -> Kept:
    """Where there is no reference: of the pixels of `where` that are warm in `before`, those still warm in `image`."""
    return _count(where & warm(before), warm(image, PALE))


def warm(image: Image, least_chroma: float = VIVID) -> Mask:
    """(height, width) of the pixels whose hue is from red to yellow."""
    hue, chroma = _hue_chroma(image)
    return np.asarray((hue >= WARM_DEG[0]) & (hue <= WARM_DEG[1]) & (chroma >= least_chroma))


def _count(where: Mask, good: Mask) -> Kept:
    return Kept(int(where.sum()), int((where & good).sum()))


def _hue_chroma(image: Image) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Degrees 0 to 360, and chroma."""
    lab = cv2.cvtColor(image.astype(np.float32) / np.float32(255), cv2.COLOR_BGR2LAB)
    a, b = lab[:, :, 1], lab[:, :, 2]
    return np.asarray(np.degrees(np.arctan2(b, a)) % 360, np.float32), np.asarray(np.hypot(a, b), np.float32)
