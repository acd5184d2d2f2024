"""Where nothing is: cells that a camera looked through to what it measured behind them.

A block's depth is now and then quite wrong, mostly too near, where the curve of its clarity has a second peak; it
says that it is sure, for what is near is measured well. So one block puts a thing into the open water. What tells it
from a thing that is there is that the others look through. In a dive of `aucamp demo --fleet survey` (seed 3)
eight and more did for each that ended there, in nine of ten such cells; where something truly was, 3.5 and fewer in
three of four.
Blocks are counted, not weighed, in integers, which do not depend on the order in which keyframes came.
"""

from __future__ import annotations

from collections.abc import Mapping

from agent.capabilities.survey.grid import FARTHEST_M, NEAREST_M, Grid, is_inner
from agent.capabilities.survey.rays import along, block_slopes, place_m, rotation
from agent.core.capability_messages import UNIT_M, Frame, measured
from agent.core.messages import Vector

FREE = 6  # cells that more than so many blocks look through for each that ends there are empty
EVERY = 2  # of the blocks, across and down: each stands for EVERY^2
SHORT = 3.0  # a ray is open water as far as so many standard deviations before its end
FAR_M = 1e9


def passed(frame: Frame, grid: Grid) -> dict[int, int]:
    """How many blocks look through each cell away from floor and walls, which are known to be there."""
    r, at = rotation(frame.turn), place_m(frame.place)
    slopes, ahead_m, cols = block_slopes(frame.lens, len(frame.sigmas)), frame.lens.ahead * UNIT_M, frame.lens.cols
    start = at[0] + r[0][2] * ahead_m, at[1] + r[1][2] * ahead_m, at[2] + r[2][2] * ahead_m
    found: dict[int, int] = {}
    for k, z_m, sigma_m in measured(frame):
        if k % cols % EVERY or k // cols % EVERY or not NEAREST_M < z_m < FARTHEST_M:
            continue
        way, depth_m = along(r, slopes[k]), z_m - ahead_m
        there = start[0] + way[0] * depth_m, start[1] + way[1] * depth_m, start[2] + way[2] * depth_m
        own = grid.number(*there)
        for number in crossed(start, way, depth_m - max(SHORT * sigma_m, 0.5 * grid.cell_m), grid):
            if number != own:
                found[number] = found.get(number, 0) + EVERY * EVERY
    return {number: count for number, count in found.items() if is_inner(number, grid)}


def crossed(at: Vector, way: Vector, depth_m: float, grid: Grid) -> list[int]:
    """Cells on the way from a place in the water to a depth, world direction per metre of it, in their order; as far as
    the water reaches (Amanatides and Woo, as in `cast`)."""
    if not all(0.0 < p < size for p, size in zip(at, grid.size_m, strict=True)):
        return []
    nx, ny, _ = grid.shape
    index, nexts, ends, strides = 0, [], [], []
    for axis, (p, w, size, stride) in enumerate(zip(at, way, grid.size_m, (1, nx, nx * ny), strict=True)):
        k = min(int(p / grid.cell_m), grid.shape[axis] - 1)
        index += k * stride
        if w == 0.0:
            nexts.append(FAR_M)
            ends.append(FAR_M)
        else:
            nexts.append(((k + (w > 0.0)) * grid.cell_m - p) / w)
            ends.append(grid.cell_m / abs(w))
            depth_m = min(depth_m, ((size if w > 0.0 else 0.0) - p) / w)
        strides.append(stride if w > 0.0 else -stride)
    tx, ty, tz = nexts
    found = [index]
    while True:
        if tx <= ty and tx <= tz:
            reached, index, tx = tx, index + strides[0], tx + ends[0]
        elif ty <= tz:
            reached, index, ty = ty, index + strides[1], ty + ends[1]
        else:
            reached, index, tz = tz, index + strides[2], tz + ends[2]
        if reached >= depth_m:
            return found
        found.append(index)


def is_free(number: int, hits: Mapping[int, int], passes: Mapping[int, int]) -> bool:
    """Whether what was measured there counts for nothing. One more block than there was is allowed for: of few, in a
    cell's corner, no share can be told."""
    return passes.get(number, 0) > FREE * (hits.get(number, 0) + 1)
