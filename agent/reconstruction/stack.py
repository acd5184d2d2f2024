"""Many views as arrays, for kernels: pictures of different sizes are laid into the corner of the largest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.process.command import Failed
from agent.reconstruction.camera import Camera, Floats, inlined
from agent.reconstruction.view import View


class Stack(NamedTuple):
    """n views; what lies beyond a picture is NaN in depth and sigma."""

    cameras: Floats  # (n, 5) f_px, cx_px, cy_px, bend, ahead_m
    sizes: NDArray[np.int64]  # (n, 2) width, height
    rotations: Floats  # (n, 3, 3) camera to world
    positions_m: Floats  # (n, 3)
    depth_m: NDArray[np.float32]  # (n, height, width)
    sigma_m: NDArray[np.float32]
    pictures: NDArray[
        np.float32
    ]  # (n, height, width, channels): 3 red green blue, 1 grey, 0: depths alone are asked for


def stacked(views: Sequence[View], channels: Literal[0, 1, 3] = 3) -> Stack:
    """Copies of what views hold, and of light as much as is asked for: of 500 views it is most of the memory.

    Raises Failed where there is no view.
    """
    if not views:
        raise Failed("there is no keyframe to reconstruct from")
    width, height = (max(getattr(view.camera, name) for view in views) for name in ("width", "height"))
    count = len(views)
    depth = np.full((count, height, width), np.nan, np.float32)
    sigma, pictures = depth.copy(), np.zeros((count, height, width, channels), np.float32)
    for n, view in enumerate(views):
        inside = np.s_[n, : view.camera.height, : view.camera.width]
        depth[inside], sigma[inside] = view.depth_m, view.sigma_m
        if channels:
            pictures[inside] = view.picture if channels == 3 else view.picture.mean(axis=-1, keepdims=True)
    return Stack(
        cameras=np.array([view.camera[:5] for view in views], float),
        sizes=np.array([view.camera[5:] for view in views], np.int64),
        rotations=np.array([view.rotation for view in views], float),
        positions_m=np.array([view.position_m for view in views], float),
        depth_m=depth,
        sigma_m=sigma,
        pictures=pictures,
    )


@inlined
def camera_in(stack: Stack, n: int) -> Camera:
    """The camera of one view, for kernels."""
    c, size = stack.cameras[n], stack.sizes[n]
    return Camera(c[0], c[1], c[2], c[3], c[4], size[0], size[1])


def camera_at(stack: Stack, n: int) -> Camera:
    """The same in plain numbers, for whom a kernel is not worth compiling."""
    f, cx, cy, bend, ahead = stack.cameras[n].tolist()
    return Camera(f, cx, cy, bend, ahead, *stack.sizes[n].tolist())
