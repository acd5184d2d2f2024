"""Make a frame look as if there were less water: grey-world white balance, then local contrast.

This is the present enhancement, and what stays for a host without torch; the paper's network (LU2Net) is not built
yet. It serves colour and the eye. Clarity is taken on the raw frame, because a gain that depends on the whole picture
changes from one focus position to the next.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

MAX_GAIN = 2.5  # a plane weaker than that holds noise, not colour
CLIP_LIMIT, TILES = 2.0, (8, 8)  # CLAHE: steep enough to lift the veil, shallow enough not to lift the noise


def enhance(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(height, width, 3) blue green red -> the same, white-balanced and with local contrast raised."""
    lab = cv2.cvtColor(white_balance(image), cv2.COLOR_BGR2LAB)
    lab[:, :, 0] = cv2.createCLAHE(CLIP_LIMIT, TILES).apply(np.ascontiguousarray(lab[:, :, 0]))
    return cv2.cvtColor(lab, cv2.COLOR_LAB2BGR)  # type: ignore[return-value]


def white_balance(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Scale the planes to one mean (grey world). Burnt-out pixels have lost their colour and do not vote."""
    votes = (image.max(axis=2) < 250).astype(np.uint8)
    mean = np.array(cv2.mean(image, votes)[:3])
    gain = np.clip(mean.mean() / np.maximum(mean, 1.0), 1.0 / MAX_GAIN, MAX_GAIN)
    table = np.clip(np.arange(256.0)[:, None] * gain[None, :] + 0.5, 0, 255).astype(np.uint8)
    return cv2.LUT(image, table[:, None, :])  # type: ignore[return-value]
