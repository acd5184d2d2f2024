"""What a depth map says across known edges in depth, and where there are none.

A block lies across an edge where the smaller side holds at least 15 % of its pixels. There a square (the block, or a
part of it) is wrong if it is accepted while at least 15 % of its pixels lie elsewhere, or if it lies far from all of
them; far is three of its own sigma, at least 2 % of the sweep. So a block across an edge that is accepted as a whole is
always wrong. Elsewhere a square is wrong that lies far from all its pixels.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agent.perception.depth_peaks import GridPeaks
from agent.perception.depth_sweep import DepthMap

MINOR = 0.15
FAR = 0.02  # of the sweep
Array = np.ndarray


class Score(NamedTuple):
    """Counts of blocks, and areas in blocks; may be added up."""

    across: int = 0  # blocks across an edge
    across_whole: int = 0  # of them accepted as a whole, all of them wrong
    across_told: float = 0.0  # area that has a depth
    across_wrong: float = 0.0  # area that has a wrong one
    across_parts: int = 0  # parts with a depth in blocks across an edge
    across_parts_wrong: int = 0
    plain: int = 0  # blocks without an edge
    plain_whole: int = 0
    plain_told: float = 0.0
    plain_wrong: float = 0.0

    def __add__(self, other: Score) -> Score:  # type: ignore[override]
        return Score(*(a + b for a, b in zip(self, other, strict=True)))


def score(found: DepthMap, truth: Array, edges: Array, known: Array, span: float) -> Score:
    """truth (height, width) in lens positions, NaN: nothing is there that has a depth.

    edges (height, width): where depth jumps. known: where the truth is known; blocks that are not all known do not
    count. span: of the sweep, lens positions.
    """
    side, (rows, cols) = found.block_px, found.blocks.reason.shape
    true = tiles(truth, side, rows, cols)
    jump, whole = tiles(edges, side, rows, cols).any(axis=-1), tiles(known, side, rows, cols).all(axis=-1)
    share = minor_share(true)
    across, plain = whole & jump & (share >= MINOR), whole & ~jump & np.isfinite(true).all(axis=-1)
    bad = wrong(found.blocks, true, across, span)
    n = found.along
    counted = np.kron(across, np.ones((n, n), bool))
    used, part_bad = found.used_parts(), np.zeros((rows * n, cols * n), bool)
    if found.parts is not None:
        cut = [np.rint(np.arange(k * n + 1) * side / n).astype(int) for k in (rows, cols)]
        for row, col in np.argwhere(used):
            at = tuple(slice(cut[k][i], cut[k][i + 1]) for k, i in enumerate((row, col)))
            one = GridPeaks(*(np.array([[field[row, col]]]) for field in found.parts[:5]))
            part_bad[row, col] = wrong(one, truth[at].reshape(1, 1, -1), counted[row : row + 1, col : col + 1], span)[
                0, 0
            ]
    per_block = (used.reshape(rows, n, cols, n).mean(axis=(1, 3)), part_bad.reshape(rows, n, cols, n).mean(axis=(1, 3)))
    accepted = found.blocks.accepted
    told, wrongly = (np.where(accepted, w, p) for w, p in zip((1.0, bad), per_block, strict=True))
    return Score(
        across=int(across.sum()),
        across_whole=int((across & accepted).sum()),
        across_told=float(told[across].sum()),
        across_wrong=float(wrongly[across].sum()),
        across_parts=int((used & counted).sum()),
        across_parts_wrong=int((part_bad & counted).sum()),
        plain=int(plain.sum()),
        plain_whole=int((plain & accepted).sum()),
        plain_told=float(told[plain].sum()),
        plain_wrong=float(wrongly[plain].sum()),
    )


def wrong(found: GridPeaks, true: Array, across: Array, span: float) -> Array:
    """(rows, cols) of squares with the true depths (rows, cols, pixels)."""
    away = np.abs(true - found.lens_position[..., None])
    far = ~(away <= np.maximum(3 * found.sigma, FAR * span)[..., None])  # of nothing everything is far
    return found.accepted & (far.all(axis=-1) | across & (far.mean(axis=-1) >= MINOR))


def minor_share(true: Array) -> Array:
    """Share of the pixels (..., pixels) on the smaller side of the middle of their depths; nothing is a side, too."""
    there = np.isfinite(true)
    low, high = (f(np.where(there, true, v), axis=-1) for f, v in ((np.min, np.inf), (np.max, -np.inf)))
    with np.errstate(invalid="ignore"):  # where nothing is known there is no middle
        middle = (low + high)[..., None] / 2
    upper = np.where(there.all(axis=-1), (true > middle).mean(axis=-1), there.mean(axis=-1))
    return np.minimum(upper, 1 - upper)


def tiles(pixels: Array, side: int, rows: int, cols: int) -> Array:
    """(height, width) -> (rows, cols, side^2)."""
    cut = pixels[: rows * side, : cols * side].reshape(rows, side, cols, side)
    return cut.transpose(0, 2, 1, 3).reshape(rows, cols, -1)
