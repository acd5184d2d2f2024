"""Light as bytes, as pictures and vertex colours have it."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

GAMMA = 2.2  # near enough to sRGB that no viewer shows the difference


def encoded(light: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Linear 0 to 1 -> 255 light ** (1 / 2.2), clipped."""
    return np.asarray(np.rint(255.0 * np.clip(light, 0.0, 1.0) ** (1.0 / GAMMA)), np.uint8)


def write_picture(light: NDArray[np.float32], path: Path) -> None:
    """(height, width, 3) red green blue, linear, as PNG."""
    cv2.imwrite(str(path), encoded(light)[..., ::-1])
