"""Which blocks of a depth map hold one depth; of the others, which parts do.

A block astride an edge in depth has the curve of the side with more texture, and of the contour between them, which is
the nearer side's: nothing in its own curve tells it from a block with one depth. So each block is cut into cells of
some 5 pixels, and 2 x 2 of them are a part. Clarity adds up, so one pass over the pixels serves all three. A cell's
peak is good to a tenth of a step of the sweep where it has texture; a median of 3 x 3 takes out those that were wrong.

* A part lies on an edge if the cells in and around it (4 x 4) are not on a plane, or it is not where they are: a plane
  is any surface over 25 pixels, a step is not. What light of a blurred foreground spills over the part beside it, and
  the contour that a part shares, is seen by the cells on the other side.
* A block holds one depth if none of its parts is on an edge or away from the block's own peak. Beside a block of
  another depth its parts are asked about what lies around them, too. A steep slope is away from one peak as well: its
  parts are what is told. (That texture shows the depth all over the block, depth_shown.py asks.)

Limits in peak widths, because how far apart two depths must be is a matter of how blurred one is when the other is
sharp; never less than a fraction of the sweep's step, which is what sampling can tell.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.focus import Array
from agent.perception.depth_peaks import GridPeaks, Reason, each_part

CELL_PX = 5  # of a cell's side, at least: a gradient is taken over 3
UNEVEN = 0.1  # of the peak's half width: how far from a plane, or from its cells, a part's depth may be
AWAY = 0.25  # the same, of a part's depth from its block's
STEP_SHARE = 0.4  # of the step between lens positions: no limit is less
KNOWN = 0.6  # of the cells in and around a part that have a peak, or nothing is known of its surroundings
OWN_CELLS = 3  # of a part's four that have a peak: one in a corner may be the neighbour's contour
ANY_CELLS = 5  # around a part: fewer do not speak against it
AROUND = np.array([(1.0, row - 1.5, col - 1.5) for row in range(4) for col in range(4)])  # 4 x 4 cells: 1, y, x


def cuts(block: int) -> int:
    """How many cells a block of so many pixels has along its side: a power of two; 1 where it is no larger than a part.

    Below 20 px a block is not cut: it would be refused on every rough surface, with no part to take its place.
    """
    along = 1 << (block // CELL_PX).bit_length() - 1
    return along if along >= 4 else 1


def in_doubt(blocks: GridPeaks, parts: GridPeaks, step: float) -> NDArray[np.bool_]:
    """(rows, cols): blocks whose parts do not all have its depth, blocks near another, and those around both.

    The others need no look at their cells, which are most of the work.
    """
    along = len(parts.reason) // len(blocks.reason)
    near = np.abs(parts.lens_position - each_part(blocks.lens_position, along)) <= limit(parts, step)
    plain = blocks.accepted & by_block(parts.accepted & near, along).all(axis=-1) & ~near_another(blocks, step)
    doubt: NDArray[np.bool_] = cv2.dilate((~plain).astype(np.uint8), np.ones((3, 3), np.uint8)).astype(bool)
    return doubt


def with_edges(blocks: GridPeaks, parts: GridPeaks, cells: GridPeaks, step: float) -> tuple[GridPeaks, GridPeaks]:
    """Blocks and parts (2 x 2 cells) with those refused that hold two depths, or whose surroundings are unknown.

    `step` between lens positions. Parts of a block that holds one depth are judged alike, and count for nothing.
    """
    along = len(parts.reason) // len(blocks.reason)
    around = four_by_four(median_of_nine(np.where(cells.accepted, cells.lens_position, np.nan)))
    edge, edge_inside = on_edge(parts, around, step), on_edge(parts, within_block(around, along), step)
    seen, inside = np.isfinite(around), np.isfinite(four_by_four(np.zeros(cells.reason.shape))).sum(axis=-1)
    known = (seen.sum(axis=-1) >= KNOWN * inside) & (seen[..., [5, 6, 9, 10]].sum(axis=-1) >= OWN_CELLS)

    from_block = np.abs(parts.lens_position - each_part(blocks.lens_position, along))
    away = parts.accepted & (from_block > apart_from_block(blocks, parts, step))
    near = near_another(blocks, step)
    two = any_part(edge_inside | (edge & each_part(near, along)) | (away & each_part(blocks.accepted, along)), along)
    parts = parts.refused(parts.accepted & ~known, Reason.NO_TEXTURE).refused(edge, Reason.TWO_DEPTHS)
    return blocks.refused(two, Reason.TWO_DEPTHS), parts


def near_another(blocks: GridPeaks, step: float) -> NDArray[np.bool_]:
    """(rows, cols): blocks beside one of another depth, so that there is an edge, or a slope, somewhere near."""
    depth = np.where(blocks.accepted, blocks.lens_position, np.nan)
    wide, (rows, cols) = np.pad(depth, 1, constant_values=np.nan), depth.shape
    around = np.stack([wide[r : r + rows, c : c + cols] for r in range(3) for c in range(3)], axis=-1)
    apart = np.maximum(AWAY * blocks.width, STEP_SHARE * step)[..., None]
    return np.asarray((np.abs(around - depth[..., None]) > apart).any(axis=-1), np.bool_)


def on_edge(parts: GridPeaks, around: Array, step: float) -> NDArray[np.bool_]:
    """Parts (rows, cols) whose cells, and those around them (rows, cols, 16), speak of another depth."""
    most = limit(parts, step) + parts.sigma
    spread, beside = np.abs(off_plane(around)).max(axis=-1), np.abs(middle(around) - parts.lens_position)
    enough = np.isfinite(around).sum(axis=-1) >= ANY_CELLS
    return np.asarray(parts.accepted & enough & ((spread > most) | (beside > most)), np.bool_)


def within_block(around: Array, along: int) -> Array:
    """The same, NaN for cells of other blocks: an edge between two blocks is in neither."""
    outside = np.zeros((along, along, 4, 4), np.bool_)
    outside[0, :, 0], outside[-1, :, 3], outside[:, 0, :, 0], outside[:, -1, :, 3] = (True,) * 4
    rows, cols = (size // along for size in around.shape[:2])
    return np.where(np.tile(outside.reshape(along, along, 16), (rows, cols, 1)), np.nan, around)


def limit(parts: GridPeaks, step: float) -> Array:
    """How far a part's depth may be from what it should be, its own uncertainty apart, lens positions."""
    most: Array = np.maximum(UNEVEN * parts.width, STEP_SHARE * step)
    return most


def apart_from_block(blocks: GridPeaks, parts: GridPeaks, step: float) -> Array:
    """How far a part's depth (rows * along, cols * along) may be from its block's, lens positions."""
    width = each_part(blocks.width, len(parts.reason) // len(blocks.reason))
    most: Array = np.maximum(AWAY * width, STEP_SHARE * step) + np.nan_to_num(parts.sigma)
    return most


def median_of_nine(values: Array) -> Array:
    """Median of each value (rows, cols) and its neighbours, without NaN; NaN stays NaN."""
    rows, cols = values.shape
    wide = np.pad(values, 1, constant_values=np.nan)
    nine = np.stack([wide[r : r + rows, c : c + cols] for r in range(3) for c in range(3)], axis=-1)
    return np.where(np.isnan(values), np.nan, middle(nine))


def middle(values: Array) -> Array:
    """Median over the last axis, without NaN; NaN where there is nothing else."""
    ordered, count = np.sort(values, axis=-1), np.isfinite(values).sum(axis=-1)
    low, high = (np.take_along_axis(ordered, k[..., None], -1) for k in (np.maximum(count - 1, 0) // 2, count // 2))
    return np.where(count > 0, (low + high)[..., 0] / 2.0, np.nan)


def four_by_four(cells: Array) -> Array:
    """(rows, cols) -> (rows / 2, cols / 2, 16): each part's four cells and the twelve around them; outside: NaN."""
    wide = np.pad(cells, 1, constant_values=np.nan)
    windows = np.lib.stride_tricks.sliding_window_view(wide, (4, 4))[::2, ::2]
    return windows.reshape(*windows.shape[:2], 16)


def off_plane(around: Array) -> Array:
    """How far each of 4 x 4 values (..., 16) is from the plane through them, by least squares; 0 for NaN."""
    seen = np.isfinite(around)
    values = np.where(seen, around, 0.0)
    normal = np.einsum("...k,ki,kj->...ij", seen.astype(float), AROUND, AROUND) + 1e-6 * np.eye(3)  # few: still solved
    plane = np.linalg.solve(normal, (values @ AROUND)[..., None])[..., 0]
    return np.where(seen, values - plane @ AROUND.T, 0.0)


def by_block(parts: NDArray[np.bool_], along: int) -> NDArray[np.bool_]:
    """(rows * along, cols * along) -> (rows, cols, along^2)."""
    rows, cols = (size // along for size in parts.shape)
    return parts.reshape(rows, along, cols, along).transpose(0, 2, 1, 3).reshape(rows, cols, -1)


def any_part(parts: NDArray[np.bool_], along: int) -> NDArray[np.bool_]:
    """(rows * along, cols * along) -> (rows, cols)."""
    return np.asarray(by_block(parts, along).any(axis=-1), np.bool_)
