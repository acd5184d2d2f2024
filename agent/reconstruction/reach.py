"""Which part of a scene a view can have to do with at all, so that work goes with what views see, not with views times
scene.

A picture lies in a round cone about its optical axis, from where its rays meet on, and what it says of the scene ends
behind its farthest depth. What is drawn or fused is taken in pieces, each with a ball around it; a piece whose ball
does not touch the cone is passed over. That never changes a result: a cone is never narrower than its picture.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Camera, Floats, inlined, ray_slopes
from agent.reconstruction.stack import Stack, camera_at
from hw.compiled import compiled

RIM_PX = 3.0  # around a picture, for what is drawn into it from outside
SLACK = 1.001  # of the farthest depth, for what float32 rounds away

kernel = compiled(error_model="numpy")


def cone(camera: Camera, rotation: Floats, position_m: Floats, far_m: float = math.inf) -> Floats:
    """(9,): where the rays meet, the axis, sine and cosine of the half angle, and how far it reaches along the axis."""
    left, top = -0.5 - RIM_PX, -0.5 - RIM_PX
    right, down = camera.width - 0.5 + RIM_PX, camera.height - 0.5 + RIM_PX
    corners = np.array([(left, top), (right, top), (left, down), (right, down)])
    half = math.atan(_steepest(camera, corners))
    axis = rotation[:, 2]
    apex = position_m + camera.ahead_m * axis
    return np.array([*apex, *axis, math.sin(half), math.cos(half), far_m - camera.ahead_m])


def _steepest(camera: Camera, corners: Floats) -> float:
    """The largest slope of a ray of the picture; where its bend folds inside it, that of the fold."""
    if camera.bend < 0.0:
        fold = math.sqrt(-1.0 / (3.0 * camera.bend))
        seen = np.hypot(*(corners - (camera.cx_px, camera.cy_px)).T) / camera.f_px
        if float(seen.max()) >= 2.0 / 3.0 * fold:
            return fold
    return float(np.hypot(*ray_slopes(camera, corners).T).max())


def cones(stack: Stack, band_m: float) -> Floats:
    """(n, 9) of all views; each ends band_m, or three sigma where that is more, behind its farthest known depth."""
    found = np.empty((len(stack.cameras), 9))
    for n in range(len(found)):
        depth, sigma = stack.depth_m[n], stack.sigma_m[n]
        known = np.isfinite(depth)
        ends = depth[known] + np.fmax(band_m, 3.0 * sigma[known])
        far = SLACK * float(ends.max()) if len(ends) else -math.inf
        found[n] = cone(camera_at(stack, n), stack.rotations[n], stack.positions_m[n], far)
    return found


@inlined
def touches(cones: Floats, n: int, x: float, y: float, z: float, radius: float) -> bool:
    """Inside kernels: whether a ball may reach into cone n."""
    dx, dy, dz = x - cones[n, 0], y - cones[n, 1], z - cones[n, 2]
    along = dx * cones[n, 3] + dy * cones[n, 4] + dz * cones[n, 5]
    across = math.sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
    within = -radius <= along <= cones[n, 8] + radius
    return bool(within and across * cones[n, 7] - along * cones[n, 6] <= radius)


def ball(points_m: Floats) -> tuple[Floats, float]:
    """Middle (3,) and radius of a ball around points (n, 3), which is not the smallest."""
    middle = 0.5 * (points_m.min(axis=0) + points_m.max(axis=0))
    return middle, float(np.sqrt(((points_m - middle) ** 2).sum(axis=1).max()))


@kernel
def balls(places: Floats, size: int, found: Floats) -> None:
    """Around each `size` places (n, 3) that follow one another: middle and radius into (m, 4)."""
    for b in range(len(found)):
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        first, last = b * size, min((b + 1) * size, len(places))
        for i in range(first, last):
            for k in range(3):
                low[k], high[k] = min(low[k], places[i, k]), max(high[k], places[i, k])
        most = 0.0
        for i in range(first, last):
            off = 0.0
            for k in range(3):
                d = places[i, k] - 0.5 * (low[k] + high[k])
                off += d * d
            most = max(most, off)
        for k in range(3):
            found[b, k] = 0.5 * (low[k] + high[k])
        found[b, 3] = math.sqrt(most)


def balls_of(places_m: Floats, size: int) -> Floats:
    """(m, 4) middle and radius around each `size` places (n, 3) that follow one another."""
    found = np.empty((-(-len(places_m) // size), 4))
    balls(places_m, size, found)
    return found


@kernel
def _meets(cones: Floats, x: float, y: float, z: float, radius: float, found: NDArray[np.bool_]) -> None:
    for n in range(len(cones)):
        found[n] = touches(cones, n, x, y, z, radius)


def meets(cones: Floats, middle_m: Floats, radius_m: float) -> NDArray[np.bool_]:
    """Which cones (n, 9) one ball may reach into."""
    found = np.empty(len(cones), np.bool_)
    x, y, z = middle_m.tolist()
    _meets(cones, x, y, z, radius_m, found)
    return found


@kernel
def _touched(around: Floats, cones: Floats, slack: float, found: NDArray[np.bool_]) -> None:
    for b in range(len(around)):
        found[b] = touches(cones, 0, around[b, 0], around[b, 1], around[b, 2], around[b, 3] + slack)


def touched(around: Floats, one: Floats, slack_m: float = 0.0) -> NDArray[np.bool_]:
    """Which balls (m, 4), larger by slack_m, may reach into one cone (9,)."""
    found = np.empty(len(around), np.bool_)
    _touched(around, one[None], slack_m, found)
    return found
