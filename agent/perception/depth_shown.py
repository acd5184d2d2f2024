"""Which blocks of a depth map show their depth all over: a plain part is filled in between others, never beyond them.

A part without texture may lie at any depth. With parts of its block's depth all around it, it is taken for the same
surface, as a plain spot of it would be; at the rim of what shows that depth there may as well be another surface, which
has no texture: a block is not told one depth there, only its parts are.

A part too weak for a peak of its own still speaks for its block, where most of what its curve does is the block's peak.
Light that a blurred neighbour spills over it does the opposite: that is least where the neighbour is sharp.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.core.ranging.focus import Array
from agent.perception.depth_box import MIN_RISE
from agent.perception.depth_edges import any_part, apart_from_block
from agent.perception.depth_peaks import GridPeaks, each_part

MOST = 0.75  # of the variance of a part's curve is its block's peak, or it does not speak for it
REACH = 2  # parts to either side: as far as a plain spot is filled in from
NEIGHBOURS = np.array([(y, x) for y in range(-REACH, REACH + 1) for x in range(-REACH, REACH + 1) if (y, x) != (0, 0)])
HALVES = (NEIGHBOURS @ NEIGHBOURS.T > 0).astype(np.float32)  # (half planes, AROUND): what lies on one side of a line


def shown(lens_positions: Array, clarity: Array, blocks: GridPeaks, parts: GridPeaks, step: float) -> NDArray[np.bool_]:
    """(rows, cols): blocks of which every part shows the block's depth, or has such parts all around it.

    clarity (n, parts down, parts across) at the lens positions (n,), a `step` apart. Without a peak: no.
    """
    along = len(parts.reason) // len(blocks.reason)
    block, apart = each_part(blocks.lens_position, along), apart_from_block(blocks, parts, step)
    agree = like_block(lens_positions, clarity, blocks, along)
    depth = np.where(parts.accepted, parts.lens_position, np.where(agree, block, np.nan))
    own = np.abs(depth - block) <= apart
    return ~any_part(~(own | enclosed(depth, block, apart)), along)


def like_block(lens_positions: Array, clarity: Array, blocks: GridPeaks, along: int) -> NDArray[np.bool_]:
    """Parts with texture (rows * along, cols * along) whose curves (n, ...) the peak of their block mostly explains."""
    x = lens_positions[:, None, None]
    peak = each_part_of_curves(1.0 / (1.0 + ((x - blocks.lens_position) / blocks.width) ** 2), along)
    peak, curve = peak - peak.mean(axis=0), clarity - clarity.mean(axis=0)
    both, scale = (peak * curve).sum(axis=0), np.sqrt((peak * peak).sum(axis=0) * (curve * curve).sum(axis=0))
    rise = clarity.max(axis=0) - np.median(clarity, axis=0)
    return np.asarray((both >= np.sqrt(MOST) * scale) & (rise >= MIN_RISE), np.bool_)  # NaN: no


def each_part_of_curves(curves: Array, along: int) -> Array:
    """(n, rows, cols) -> (n, rows * along, cols * along)."""
    return np.repeat(np.repeat(curves, along, axis=1), along, axis=2)


def enclosed(depth: Array, block: Array, apart: Array) -> NDArray[np.bool_]:
    """Parts (rows, cols) with some of their block's depth around them on either side of every line through them.

    depth: of each part, NaN where it shows none; block: of the block it is in; apart: as far as both may differ.
    """
    (rows, cols), wide = depth.shape, np.pad(depth, REACH, mode="symmetric")
    moved = (wide[REACH + y : REACH + y + rows, REACH + x : REACH + x + cols] for y, x in NEIGHBOURS)
    same = np.stack([np.abs(one - block) <= apart for one in moved], axis=-1)
    return np.asarray((same.astype(np.float32) @ HALVES > 0).all(axis=-1), np.bool_)
