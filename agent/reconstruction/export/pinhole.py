"""A view as other programs model cameras: rays meet in the camera's centre, the first pixel's corner is (0, 0).

Our rays meet `ahead_m` before the pivot, so that is where their centre goes; our first pixel's middle is (0, 0), so
theirs is half a pixel on. The bend is their first radial coefficient: u = f x (1 + k1 r^2) + cx, exactly.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agent.reconstruction.camera import Floats
from agent.reconstruction.view import View


class Pinhole(NamedTuple):
    f_px: float
    cx_px: float
    cy_px: float
    k1: float
    width: int
    height: int
    rotation: Floats  # (3, 3) camera (right, down, ahead) to world
    centre_m: Floats  # (3,)


def pinhole(view: View) -> Pinhole:
    """The same view, in their convention."""
    camera = view.camera
    centre = view.position_m + camera.ahead_m * view.rotation[:, 2]
    f, cx, cy = camera.f_px, camera.cx_px + 0.5, camera.cy_px + 0.5
    return Pinhole(f, cx, cy, camera.bend, camera.width, camera.height, view.rotation, centre)


def quaternion(rotation: Floats) -> Floats:
    """(w, x, y, z) of a rotation (3, 3), w >= 0."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] - r[1, 1] - r[2, 2], 0.0, 0.0, 0.0],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], 0.0, 0.0],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], 0.0],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )
    _, vectors = np.linalg.eigh(k / 3.0)  # reads the lower triangle: Bar-Itzhack 2000
    x, y, z, w = vectors[:, -1]
    return np.array([w, x, y, z]) * (1.0 if w >= 0.0 else -1.0)


def names(views: list[View]) -> list[str]:
    """A file name for each view, without an ending."""
    return [f"{view.robot}_{view.seq:05d}_{n:04d}" for n, view in enumerate(views)]
