"""Many views as arrays, for kernels: pictures of different sizes are laid into the corner of the largest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.failure import Failed
from agent.reconstruction.camera import Camera, Floats
from agent.reconstruction.view import View


class Stack(NamedTuple):
    """n views; what lies beyond a picture is NaN in depth and sigma."""

    cameras: Floats  # (n, 5) f_px, cx_px, cy_px, bend, ahead_m
    sizes: NDArray[np.int64]  # (n, 2) width, height
    rotations: Floats  # (n, 3, 3) camera to world
    positions_m: Floats  # (n, 3)
    depth_m: NDArray[np.float32]  # (n, height, width)
    sigma_m: NDArray[np.float32]
    pictures: NDArray[np.float32]  # (n, height, width, 3)


def stacked(views: Sequence[View]) -> Stack:
    """Raises Failed where there is no view."""
    if not views:
        raise Failed("there is no keyframe to reconstruct from")
    width, height = (max(getattr(view.camera, name) for view in views) for name in ("width", "height"))
    count = len(views)
    depth = np.full((count, height, width), np.nan, np.float32)
    sigma, pictures = depth.copy(), np.zeros((count, height, width, 3), np.float32)
    for n, view in enumerate(views):
        inside = np.s_[n, : view.camera.height, : view.camera.width]
        depth[inside], sigma[inside], pictures[inside] = view.depth_m, view.sigma_m, view.picture
    return Stack(
        cameras=np.array([view.camera[:5] for view in views], float),
        sizes=np.array([view.camera[5:] for view in views], np.int64),
        rotations=np.array([view.rotation for view in views], float),
        positions_m=np.array([view.position_m for view in views], float),
        depth_m=depth,
        sigma_m=sigma,
        pictures=pictures,
    )


def camera_at(stack: Stack, n: int) -> Camera:
    """The camera of one view."""
    f, cx, cy, bend, ahead = stack.cameras[n].tolist()
    return Camera(f, cx, cy, bend, ahead, *stack.sizes[n].tolist())
