"""A signed distance to the surface on a grid that exists only where there is a surface: bricks of 8 x 8 x 8 cells.

A whole basin at 5 mm is 200 million cells; those within reach of a measured depth are some per cent of them. Cones and
balls tell which part of a scene a view can have to do with at all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.process.command import Failed
from agent.reconstruction.views import (
    Camera,
    Floats,
    Stack,
    camera_at,
    camera_in,
    inlined,
    ray_slopes,
    slopes_of,
    unproject,
)
from hw.compiled import compiled

SIDE = 8  # cells along a brick
MOST_BRICKS = 400_000  # 205 million cells, 1.8 GB: more is a pose or a calibration gone wrong, or a cell too small
MOST_PLACES = 50_000_000  # of the table of bricks, 200 MB
OUTLIERS = 0.002  # share of the depths that may lie outside the grid, at either end of each axis
RIM_M = 0.05  # of the grid around the rest

kernel = compiled(error_model="numpy")


class Surface(NamedTuple):
    """Cell (i, j, k) has its middle at origin_m + cell_m (i, j, k); it is in brick table[i // 8, j // 8, k // 8]."""

    cell_m: float
    origin_m: Floats  # (3,)
    table: NDArray[np.int32]  # (rows, cols, layers) of bricks; -1: none
    distance_m: NDArray[np.float32]  # (bricks, 8, 8, 8) to the surface along the sight line; positive before it
    weight: NDArray[np.float32]  # (bricks, 8, 8, 8) sum of 1e-4 / sigma^2; 0: unknown
    views: NDArray[np.uint8]  # (bricks, 8, 8, 8) how many saw it near the surface


def allocated(stack: Stack, cell_m: float, reach_m: float, like: Surface | None = None) -> Surface:
    """Bricks within reach_m, or sigma where it is more, of every known depth. Raises Failed where there is none.

    like: a surface whose table of places it has; what is outside is left out.
    """
    origin, shape = _places(stack, cell_m) if like is None else (like.origin_m, like.table.shape)
    index = np.full(shape, -1, np.int32)
    _mark(stack, origin, cell_m, reach_m, index)
    wanted = index == 0
    count = int(wanted.sum())
    if count > MOST_BRICKS:
        raise Failed(f"a surface of {count} bricks does not fit the memory; make cells of {1e3 * cell_m:g} mm larger")
    index[wanted] = np.arange(count)
    cells = (count, SIDE, SIDE, SIDE)
    return Surface(
        cell_m=cell_m,
        origin_m=origin,
        table=index,
        distance_m=np.zeros(cells, np.float32),
        weight=np.zeros(cells, np.float32),
        views=np.zeros(cells, np.uint8),
    )


def _places(stack: Stack, cell_m: float) -> tuple[Floats, tuple[int, ...]]:
    """Origin and shape of a table that has room for all depths, some outliers apart."""
    low, high = bounds(stack)
    origin = np.floor(low / cell_m) * cell_m
    shape = np.ceil((high - origin) / (SIDE * cell_m)).astype(np.int64) + 1
    if float(np.prod(shape.astype(float))) > MOST_PLACES:
        size = " x ".join(f"{length:.0f}" for length in high - low)
        raise Failed(f"the depths spread over {size} m: too much for cells of {1e3 * cell_m:g} mm; make them larger")
    return origin, tuple(shape.tolist())


def bounds(stack: Stack) -> tuple[Floats, Floats]:
    """Lowest and highest corner (3,) of what the depths show, some outliers apart. Raises Failed without a depth."""
    points = np.concatenate([_some_points(stack, n) for n in range(len(stack.cameras))])
    if not len(points):
        raise Failed("no keyframe has a depth: nothing was sharp enough to tell one")
    low, high = np.quantile(points, (OUTLIERS, 1.0 - OUTLIERS), axis=0)
    return low - RIM_M, high + RIM_M


def _some_points(stack: Stack, n: int) -> Floats:
    """Places (m, 3) of one in 16 known pixels of a view."""
    depth = np.asarray(stack.depth_m[n, ::4, ::4], np.float64)
    rows, cols = np.nonzero(np.isfinite(depth))
    pixels = np.stack([cols, rows], axis=-1).astype(np.float64) * 4.0
    points = unproject(camera_at(stack, n), pixels, depth[rows, cols])
    return np.asarray(points @ stack.rotations[n].T + stack.positions_m[n])


@kernel
def _mark(stack: Stack, origin: Floats, cell_m: float, reach_m: float, index: NDArray[np.int32]) -> None:
    """0 into the bricks that are near a depth."""
    brick_m = SIDE * cell_m
    steps_m = 0.4 * brick_m
    for n in range(stack.depth_m.shape[0]):
        camera, size = camera_in(stack, n), stack.sizes[n]
        r, t = stack.rotations[n], stack.positions_m[n]
        for row in range(size[1]):
            for col in range(size[0]):
                depth = stack.depth_m[n, row, col]
                if not depth > 0.0:
                    continue
                reach = max(reach_m, float(stack.sigma_m[n, row, col]))
                x, y = slopes_of(camera, float(col), float(row))
                count = int(2.0 * reach / steps_m) + 2
                for step in range(count + 1):
                    z = depth - reach + 2.0 * reach * step / count
                    px, py = x * (z - camera.ahead_m), y * (z - camera.ahead_m)
                    i = int((r[0, 0] * px + r[0, 1] * py + r[0, 2] * z + t[0] - origin[0]) / brick_m)
                    j = int((r[1, 0] * px + r[1, 1] * py + r[1, 2] * z + t[1] - origin[1]) / brick_m)
                    k = int((r[2, 0] * px + r[2, 1] * py + r[2, 2] * z + t[2] - origin[2]) / brick_m)
                    if 0 <= i < index.shape[0] and 0 <= j < index.shape[1] and 0 <= k < index.shape[2]:
                        index[i, j, k] = 0


# --- what a view can reach: work goes with what views see, not with views times scene ---
#
# A picture lies in a round cone about its optical axis, from where its rays meet on, and what it says of the scene
# ends behind its farthest depth. What is drawn or fused is taken in pieces, each with a ball around it; a piece whose
# ball does not touch the cone is passed over. That never changes a result: a cone is never narrower than its picture.

RIM_PX = 3.0  # around a picture, for what is drawn into it from outside
SLACK = 1.001  # of the farthest depth, for what float32 rounds away


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
