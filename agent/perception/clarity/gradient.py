"""Luminance and gradient of a whole picture, by OpenCV: for who needs no compiled code, and is spared its import."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

Grey = NDArray[np.uint8]  # (height, width)


def luminance(image: NDArray[np.uint8]) -> Grey:
    """(height, width, 3) blue green red, or already grey -> (height, width)."""
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)  # type: ignore[return-value]


def gradient_energy(grey: Grey) -> NDArray[np.float32]:
    """Gx^2 + Gy^2 of every pixel, (height, width); the image goes on as its own mirror beyond its border."""
    gx, gy = (g.astype(np.float32) for g in cv2.spatialGradient(grey, borderType=cv2.BORDER_REFLECT_101))
    return gx * gx + gy * gy  # at most 2.1e6: exact in single precision
