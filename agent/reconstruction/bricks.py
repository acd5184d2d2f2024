"""A signed distance to the surface on a grid that exists only where there is a surface: bricks of 8 x 8 x 8 cells.

A whole basin at 5 mm is 200 million cells; those within reach of a measured depth are some per cent of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.process.command import Failed
from agent.reconstruction.camera import Floats, slopes_of, unproject
from agent.reconstruction.stack import Stack, camera_at, camera_in
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


def allocated(stack: Stack, cell_m: float, reach_m: float) -> Surface:
    """Bricks within reach_m, or sigma where it is more, of every known depth. Raises Failed where there is none."""
    low, high = bounds(stack)
    origin = np.floor(low / cell_m) * cell_m
    shape = np.ceil((high - origin) / (SIDE * cell_m)).astype(np.int64) + 1
    if float(np.prod(shape.astype(float))) > MOST_PLACES:
        size = " x ".join(f"{length:.0f}" for length in high - low)
        raise Failed(f"the depths spread over {size} m: too much for cells of {1e3 * cell_m:g} mm; make them larger")
    index = np.full(tuple(shape.tolist()), -1, np.int32)
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
