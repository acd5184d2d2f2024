"""How far each pixel is, with its uncertainty, from the blocks of a sweep.

Blocks, and the parts of those that hold two depths, are sharp at their mean vergence, so 1/z is what lies on a line
between them: a pixel has the bilinear mean of the four around it, if they agree,

    spread z < MOST_SPREAD,  sigma^2 = s^2 + (SPREAD_SHARE spread z^2)^2 + FLOOR_M^2

spread: the largest of the four 1/z less the smallest; s: mean of their standard deviations. Where one is unknown, a
pixel in the triangle between the other three has the plane through them. Whole blocks first, which hold more texture;
parts fill in between.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.camera_model import FocusFit
from agent.perception.depth_peaks import GridPeaks
from agent.perception.depth_sweep import DepthMap
from agent.reconstruction.camera import Floats

MOST_SPREAD = 0.12  # of the range: four blocks that differ by more are not on one surface
SPREAD_SHARE = 0.1  # of the spread, as an error: a surface between blocks is not quite a plane
FLOOR_M = 2e-3  # what no block is better than, whatever its fit says


class FocusMap(NamedTuple):
    """Of every pixel of the smaller picture; float32, NaN where unknown."""

    depth_m: NDArray[np.float32]  # (height, width)
    sigma_m: NDArray[np.float32]


def focus_map(found: DepthMap, focus: FocusFit, times: int, size: tuple[int, int]) -> FocusMap:
    """Depths of pixels of a picture `times` smaller than the one that was measured; size (width, height) of it.

    found has ranges of this calibration.
    """
    depth, sigma = _from_grid(found.blocks, focus, found.block_px, times, size)
    if found.parts is not None:
        finer, its = _from_grid(found.parts, focus, found.block_px / found.along, times, size)
        depth, sigma = np.where(np.isnan(depth), finer, depth), np.where(np.isnan(depth), its, sigma)
    return FocusMap(depth.astype(np.float32), sigma.astype(np.float32))


def range_sigma_m(peaks: GridPeaks, focus: FocusFit) -> Floats:
    """Standard deviation (rows, cols) of the ranges, metres: the random part of ranging.focus.range_variance."""
    travel = peaks.lens_position - focus.rho0
    noise: Floats = np.abs(focus.b_m) / (travel * travel) * np.maximum(peaks.sigma, focus.noise)
    return noise


def _from_grid(
    peaks: GridPeaks, focus: FocusFit, side_px: float, times: int, size: tuple[int, int]
) -> tuple[Floats, Floats]:
    assert peaks.range_m is not None  # it was measured with a calibration
    known = peaks.accepted & np.isfinite(peaks.range_m)
    vergence = np.where(known, 1.0 / np.where(known, peaks.range_m, 1.0), np.nan)
    sigma = np.where(known, range_sigma_m(peaks, focus), np.nan)
    (top, down), (left, across) = (
        _between(length, count, side_px, times) for length, count in zip(size[::-1], vergence.shape, strict=True)
    )
    corners = [(top + i, left + j) for i in (0, 1) for j in (0, 1)]
    shares = [(1 - down, 1 - across), (1 - down, across), (down, 1 - across), (down, across)]
    weight = np.stack([np.outer(*share) for share in shares])
    four = _with_the_fourth(np.stack([_picked(vergence, *corner) for corner in corners]), weight)
    depth: Floats = 1.0 / (weight * four).sum(axis=0)
    spread = four.max(axis=0) - four.min(axis=0)
    each = np.stack([_picked(sigma, *corner) for corner in corners])
    s = np.nansum(each, axis=0) / np.maximum(np.isfinite(each).sum(axis=0), 1)
    with np.errstate(invalid="ignore"):
        agree = spread * depth < MOST_SPREAD
    total = np.sqrt(s**2 + (SPREAD_SHARE * spread * depth**2) ** 2 + FLOOR_M**2)
    return np.where(agree, depth, np.nan), np.where(agree, total, np.nan)


def _with_the_fourth(four: Floats, weight: Floats) -> Floats:
    """Where one of the four (4, height, width) is unknown, what the plane through the others has there: for pixels in
    the triangle between them, which are nearer to the one across than to the one that is missing."""
    filled = four.copy()
    for k in range(4):
        a, b = (j for j in range(4) if j not in (k, 3 - k))
        plane = four[a] + four[b] - four[3 - k]
        filled[k] = np.where(np.isnan(four[k]) & (weight[k] <= weight[3 - k]), plane, four[k])
    return filled


def _between(length: int, count: int, side_px: float, times: int) -> tuple[NDArray[np.int64], Floats]:
    """For each small pixel along one side, the square before it and its share of the way to the next; -1: beyond."""
    full = np.arange(length) * times + (times - 1) / 2.0
    at = (full - (side_px - 1.0) / 2.0) / side_px
    first = np.floor(at).astype(np.int64)
    return np.where((first >= 0) & (first < count - 1), first, -2), at - first


def _picked(values: Floats, rows: NDArray[np.int64], cols: NDArray[np.int64]) -> Floats:
    inside = ((rows >= 0)[:, None]) & (cols >= 0)[None]
    return np.where(inside, values[np.maximum(rows, 0)[:, None], np.maximum(cols, 0)[None]], np.nan)
