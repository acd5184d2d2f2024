"""The outline of a sphere, as a cone of rays.

It is a circular cone of rays m around the direction of the centre: m . g = 1, with g = a / cos(theta), a the axis and
theta the apparent angular radius. That is linear in g and exact off the optical axis, where the image is an ellipse
and its centroid is not the centre's image.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import UNBEND, CameraFit

Array = NDArray[np.float64]

RAYS = 96  # points of the outline
TRIALS = 60  # RANSAC, three points each: with 60 % good points one of 60 triples is good but for 1 in 10^6
TURN = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
CIRCLE = np.column_stack([np.cos(TURN), np.sin(TURN)])  # (RAYS, 2)
SEED = 1  # the same frame gives the same answer


class Cone(NamedTuple):
    axis: Array  # (3,) unit vector, camera frame
    theta_rad: float


@lru_cache(maxsize=256)
def _triples(count: int) -> NDArray[np.int64]:
    """(TRIALS, 3) of so many points: the same ones each time."""
    return np.random.Generator(np.random.PCG64(SEED)).integers(0, count, (TRIALS, 3))


def consensus(rays: Array, camera: CameraFit, tolerance_px: float) -> Cone | None:
    """RANSAC over triples, then least squares of m . g = 1 on the rays that agree, twice."""
    m1, m2, m3 = rays[_triples(len(rays)).T]
    normal = _cross(m2 - m1, m3 - m1)  # of the plane through three points of the unit sphere
    offset = (normal * m1).sum(axis=1)
    size = np.sqrt((normal * normal).sum(axis=1))
    usable = np.abs(offset) > 0.2 * size  # theta below 78 deg, and three different points
    usable &= size > 1e-12
    if not usable.any():
        return None
    g = normal[usable] / offset[usable, None]
    theta_tolerance = tolerance_px / camera.f_px
    miss = np.abs(rays @ g.T - 1.0) / np.sqrt(np.maximum((g * g).sum(axis=1) - 1.0, 1e-9))
    return refined(_cone(g[np.argmax((miss < theta_tolerance).sum(axis=0))]), rays, camera, tolerance_px)


def refined(cone: Cone | None, rays: Array, camera: CameraFit, tolerance_px: float) -> Cone | None:
    """Least squares of m . g = 1 on the rays that agree with a cone, twice; None where they are too few."""
    for _ in range(2):
        if cone is None:
            return None
        near = rays[agree(rays, cone, camera, tolerance_px)]
        if len(near) < 6:
            return None
        cone = _cone(np.asarray(np.linalg.lstsq(near, np.ones(len(near)), rcond=None)[0], float))
    return cone


def _cross(a: Array, b: Array) -> Array:
    """a x b of (n, 3): numpy's own takes four times as long."""
    (ax, ay, az), (bx, by, bz) = a.T, b.T
    return np.column_stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _cone(g: Array) -> Cone | None:
    length = float(np.sqrt((g * g).sum()))
    if not length > 1.0 or g[2] <= 0.0:
        return None
    return Cone(g / length, float(np.arccos(1.0 / length)))


def misses_px(rays: Array, cone: Cone, camera: CameraFit) -> Array:
    """How far outside the cone each ray is."""
    misses: Array = (np.arccos(np.clip(rays @ cone.axis, -1.0, 1.0)) - cone.theta_rad) * camera.f_px
    return misses


def agree(rays: Array, cone: Cone, camera: CameraFit, tolerance_px: float) -> NDArray[np.bool_]:
    """Which rays are on the cone."""
    return np.abs(misses_px(rays, cone, camera)) < tolerance_px


def outline(cone: Cone, camera: CameraFit) -> Array:
    """RAYS pixels (RAYS, 2) around the cone."""
    x, _, z = cone.axis
    side = np.array([-z, 0.0, x]) / math.hypot(x, z)
    other = _cross(cone.axis[None], side[None])[0]
    ring = CIRCLE[:, :1] * side + CIRCLE[:, 1:] * other
    return project(np.cos(cone.theta_rad) * cone.axis + np.sin(cone.theta_rad) * ring, camera)


def to_rays(points_px: Array, camera: CameraFit) -> Array:
    """Unit rays (n, 3), camera frame, through pixels (n, 2)."""
    m: Array = np.ones((len(points_px), 3))
    seen = (points_px - (camera.cx_px, camera.cy_px)) / camera.f_px
    m[:, :2] = seen
    if camera.bend:
        for _ in range(UNBEND):
            m[:, :2] = seen / (1.0 + camera.bend * (m[:, :2] ** 2).sum(axis=1, keepdims=True))
    m /= np.sqrt((m * m).sum(axis=1))[:, None]
    return m


def project(directions: Array, camera: CameraFit) -> Array:
    """Pixels (..., 2) of directions (..., 3) in front of the camera."""
    slope = directions[..., :2] / directions[..., 2:]
    slope = slope * (1.0 + camera.bend * (slope * slope).sum(axis=-1, keepdims=True))
    px: Array = camera.f_px * slope + np.array([camera.cx_px, camera.cy_px])
    return px
