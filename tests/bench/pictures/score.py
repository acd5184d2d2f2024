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
    plain: int = 0  # blocks without an edge
    plain_told: float = 0.0
    plain_wrong: float = 0.0

    def __add__(self, other: Score) -> Score:  # type: ignore[override]
        return Score(*(a + b for a, b in zip(self, other, strict=True)))


def score(found: DepthMap, truth: Array, span: float) -> Score:
    """truth (height, width) in lens positions; span: of the sweep, lens positions."""
    side, (rows, cols) = found.block_px, found.blocks.reason.shape
    true, jumps = tiles(truth, side, rows, cols), np.hypot(*np.gradient(truth)) > 0.5
    upper = (true > (true.min(axis=-1) + true.max(axis=-1))[..., None] / 2).mean(axis=-1)  # of the middle of depths
    jump = tiles(jumps, side, rows, cols).any(axis=-1)
    across, plain = jump & (np.minimum(upper, 1 - upper) >= MINOR), ~jump
    bad = wrong(found.blocks, true, across, span)
    n, used = found.along, found.used_parts()
    part_bad = np.zeros_like(used)
    if found.parts is not None:
        in_parts = tiles(truth, side // n, rows * n, cols * n)  # blocks are cut into whole pixels
        part_bad = used & wrong(found.parts, in_parts, np.kron(across, np.ones((n, n), bool)), span)
    per_block = (used.reshape(rows, n, cols, n).mean(axis=(1, 3)), part_bad.reshape(rows, n, cols, n).mean(axis=(1, 3)))
    accepted = found.blocks.accepted
    told, wrongly = (np.where(accepted, w, p) for w, p in zip((1.0, bad), per_block, strict=True))
    return Score(
        across=int(across.sum()),
        across_whole=int((across & accepted).sum()),
        across_told=float(told[across].sum()),
        across_wrong=float(wrongly[across].sum()),
        plain=int(plain.sum()),
        plain_told=float(told[plain].sum()),
        plain_wrong=float(wrongly[plain].sum()),
    )


def wrong(found: GridPeaks, true: Array, across: Array, span: float) -> Array:
    """(rows, cols) of squares with the true depths (rows, cols, pixels)."""
    away = np.abs(true - found.lens_position[..., None])
    far = ~(away <= np.maximum(3 * found.sigma, FAR * span)[..., None])  # of nothing everything is far
    return found.accepted & (far.all(axis=-1) | across & (far.mean(axis=-1) >= MINOR))


def tiles(pixels: Array, side: int, rows: int, cols: int) -> Array:
    """(height, width) -> (rows, cols, side^2)."""
    cut = pixels[: rows * side, : cols * side].reshape(rows, side, cols, side)
    return cut.transpose(0, 2, 1, 3).reshape(rows, cols, -1)
