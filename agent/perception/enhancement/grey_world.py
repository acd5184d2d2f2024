"""White balance and local contrast: what a host without the network has, and what the network has to beat.

Pictures are (height, width, 3) uint8, blue green red.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

MAX_GAIN = 2.5  # a plane weaker than that holds noise, not colour
CLIP_LIMIT, TILES = 2.0, (8, 8)  # CLAHE: steep enough to lift the veil, shallow enough not to lift the noise


def white_balance(image: Image) -> Image:
    """Scale the planes to one mean (grey world). Burnt-out pixels have lost their colour and do not vote."""
    votes = (image.max(axis=2) < 250).astype(np.uint8)
    mean = np.array(cv2.mean(image, votes)[:3])
    gain = np.clip(mean.mean() / np.maximum(mean, 1.0), 1.0 / MAX_GAIN, MAX_GAIN)
    table = np.clip(np.arange(256.0)[:, None] * gain[None, :] + 0.5, 0, 255).astype(np.uint8)
    return cv2.LUT(image, table[:, None, :])  # type: ignore[return-value]


def clahe(image: Image) -> Image:
    """Contrast-limited adaptive histogram equalisation (Zuiderveld 1994) of the lightness; colours stay."""
    lab = cv2.cvtColor(image, cv2.COLOR_BGR2LAB)
    lab[:, :, 0] = cv2.createCLAHE(CLIP_LIMIT, TILES).apply(np.ascontiguousarray(lab[:, :, 0]))
    return cv2.cvtColor(lab, cv2.COLOR_LAB2BGR)  # type: ignore[return-value]


def classic(image: Image) -> Image:
    """Both, one after the other."""
    return clahe(white_balance(image))
