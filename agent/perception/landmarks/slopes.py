"""Pixels to slopes and back, many at once: `camera_model.ray` and `pixel` for arrays.

A slope is (x, y) / (z - ahead_m) in the camera frame, where a straight edge is straight: the lens's bending is undone.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import UNBEND, CameraFit

Array = NDArray[np.float64]


def to_slopes(camera: CameraFit, points_px: Array) -> Array:
    """(..., 2) pixels -> (..., 2) slopes."""
    seen: Array = (points_px - (camera.cx_px, camera.cy_px)) / camera.f_px
    slopes = seen
    for _ in range(UNBEND if camera.bend else 0):
        slopes = seen / (1.0 + camera.bend * (slopes * slopes).sum(axis=-1, keepdims=True))
    return slopes


def to_pixels(camera: CameraFit, slopes: Array) -> Array:
    """(..., 2) slopes -> (..., 2) pixels."""
    bend = 1.0 + camera.bend * (slopes * slopes).sum(axis=-1, keepdims=True)
    out: Array = camera.f_px * bend * slopes + (camera.cx_px, camera.cy_px)
    return out


def cross(a: Array, b: Array) -> Array:
    """(..., 2) x (..., 2) -> (...), positive where b lies clockwise of a as seen (y goes down)."""
    out: Array = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return out
