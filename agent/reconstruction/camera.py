"""A camera under water as reconstruction sees it: points to pixels and back, for whole pictures and inside kernels.

Camera frame: x right, y down, z forward, origin at the gimbal's pivot. Rays meet `ahead_m` before the pivot. A point
p has the slopes (x, y) = (p_x, p_y) / (p_z - ahead_m) and is seen at

    u = cx + f x (1 + bend (x^2 + y^2)),  v = cy + f y (1 + bend (x^2 + y^2))

which is the model of agent/core/ranging/camera_model.py, with the centre of the first pixel at (0, 0). A depth is
p_z, from the pivot along the axis.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.compiled import compiled

Floats = NDArray[np.float64]

NEWTON = 8  # rounds for the cubic r (1 + bend r^2) = R; from R on they converge quadratically, five are enough at 1e-12
inlined = compiled(inline="always", error_model="numpy")


class Camera(NamedTuple):
    """Intrinsics of one picture, pixels; `ahead_m` in metres. Kernels take it as it is."""

    f_px: float
    cx_px: float
    cy_px: float
    bend: float
    ahead_m: float
    width: int
    height: int


def shrunk(camera: Camera, times: int) -> Camera:
    """The camera of pictures that are so many times smaller (each pixel the mean of times x times); a rest is cut."""
    half = (times - 1) / 2.0
    return Camera(
        camera.f_px / times,
        (camera.cx_px - half) / times,
        (camera.cy_px - half) / times,
        camera.bend,
        camera.ahead_m,
        camera.width // times,
        camera.height // times,
    )


def project(camera: Camera, points_m: Floats) -> Floats:
    """Points of the camera frame (..., 3) -> pixels (..., 2); NaN behind where rays meet, or where the bend folds."""
    depth = points_m[..., 2] - camera.ahead_m
    with np.errstate(divide="ignore", invalid="ignore"):
        slopes = points_m[..., :2] / depth[..., None]
        r2 = (slopes * slopes).sum(axis=-1)
        pixels = camera.f_px * slopes * (1.0 + camera.bend * r2)[..., None]
    pixels += (camera.cx_px, camera.cy_px)
    return np.where(((depth > 0.0) & (1.0 + 3.0 * camera.bend * r2 > 0.0))[..., None], pixels, np.nan)


def ray_slopes(camera: Camera, pixels: Floats) -> Floats:
    """Pixels (..., 2) -> slopes (..., 2) of their rays: a ray is (0, 0, ahead_m) + t (x, y, 1)."""
    seen = (pixels - (camera.cx_px, camera.cy_px)) / camera.f_px
    target = np.sqrt((seen * seen).sum(axis=-1))
    radius = target.copy()
    for _ in range(NEWTON):
        r2 = radius * radius
        radius -= (radius * (1.0 + camera.bend * r2) - target) / (1.0 + 3.0 * camera.bend * r2)
    return np.asarray(seen * (1.0 / (1.0 + camera.bend * radius * radius))[..., None])


def unproject(camera: Camera, pixels: Floats, depth_m: NDArray[Any]) -> Floats:
    """Pixels (..., 2) at depths (...) -> points of the camera frame (..., 3)."""
    slopes = ray_slopes(camera, pixels)
    return np.concatenate([slopes * (depth_m - camera.ahead_m)[..., None], depth_m[..., None]], axis=-1)


def pixel_grid(camera: Camera) -> Floats:
    """The centres (u, v) of all pixels, (height, width, 2)."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(float)
    return np.stack([u, v], axis=-1)


@inlined
def pixel_of(camera: Camera, x_m: float, y_m: float, z_m: float) -> tuple[float, float, bool]:
    """Inside kernels: the pixel (u, v) of one point of the camera frame, and whether it is before the camera."""
    depth = z_m - camera.ahead_m
    x, y = x_m / depth, y_m / depth
    r2 = x * x + y * y
    scale = camera.f_px * (1.0 + camera.bend * r2)
    return camera.cx_px + scale * x, camera.cy_px + scale * y, depth > 1e-6 and 1.0 + 3.0 * camera.bend * r2 > 0.0


@inlined
def slopes_of(camera: Camera, u: float, v: float) -> tuple[float, float]:
    """Inside kernels: the slopes (x, y) of one pixel's ray."""
    x, y = (u - camera.cx_px) / camera.f_px, (v - camera.cy_px) / camera.f_px
    target = math.sqrt(x * x + y * y)
    radius = target
    for _ in range(5):
        r2 = radius * radius
        radius -= (radius * (1.0 + camera.bend * r2) - target) / (1.0 + 3.0 * camera.bend * r2)
    scale = 1.0 / (1.0 + camera.bend * radius * radius)
    return x * scale, y * scale
