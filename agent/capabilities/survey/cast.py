"""What a camera would see from somewhere, by the map as it is: rays through cells that nothing is known to be in, until
one that something is in, or a wall or the floor."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from typing import NamedTuple

from agent.capabilities.survey.evidence import ALONE_COS
from agent.capabilities.survey.grid import FARTHEST_M, NEAREST_M, Grid, expected_mm, information, is_inner
from agent.capabilities.survey.rays import Slopes, along, place_m, rotation, slope
from agent.core.capability_messages import Lens, View
from agent.core.messages import Vector

ACROSS, DOWN = 13, 10  # rays of a view: as many blocks stand for one
FAR = 1e9
ROUNDING_M = 1e-9  # a wall lies on the edge of a cell, and the ray ends before it is in none


class Beam(NamedTuple):
    """The rays of one camera, the same for each view."""

    slopes: Slopes
    worth: int  # blocks for which a ray stands, times 100


def beam(lens: Lens, rows: int) -> Beam:
    slopes = tuple(
        slope(lens, (i + 0.5) * lens.cols / ACROSS, (j + 0.5) * rows / DOWN) for j in range(DOWN) for i in range(ACROSS)
    )
    return Beam(slopes, max(round(100 * lens.cols * rows / (ACROSS * DOWN)), 1))


def expected(view: View, beam: Beam, grid: Grid, stops: Collection[int]) -> dict[int, int]:
    """Which cells a view would add how much to; what of them counts is for `gain` to say. stops: cells that no ray
    passes."""
    r, at = rotation(view.turn), place_m(view.place)
    found: dict[int, int] = {}
    for s in beam.slopes:
        hit = cast(at, along(r, s), grid, stops)
        if hit is None:
            continue
        number, z_m, cos = hit
        if NEAREST_M < z_m < FARTHEST_M and (weight := information(cos, expected_mm(z_m, view.sigma))):
            found[number] = found.get(number, 0) + weight * beam.worth // 100
    return found


def cast(at: Vector, way: Vector, grid: Grid, stops: Collection[int]) -> tuple[int, float, float] | None:
    """The first cell that stops a ray, its depth, and the cosine there; None: it leaves through the surface, or goes
    too far. way: world direction per metre of depth (Amanatides and Woo, A fast voxel traversal algorithm for ray
    tracing, Eurographics 1987)."""
    if not all(0.0 < p < size for p, size in zip(at, grid.size_m, strict=True)):
        return None
    cell_m, (nx, ny, _) = grid.cell_m, grid.shape
    steps, nexts, strides, ends, index = [], [], [], [], 0
    exit_z, exit_axis = FAR, 2
    for axis, (p, w, size, stride) in enumerate(zip(at, way, grid.size_m, (1, nx, nx * ny), strict=True)):
        k = min(int(p / cell_m), grid.shape[axis] - 1)
        index += k * stride
        step = 1 if w > 0.0 else -1
        if w == 0.0:
            nexts.append(FAR)
            ends.append(FAR)
        else:
            nexts.append(((k + (step > 0)) * cell_m - p) / w)
            ends.append(cell_m / abs(w))
            out = ((size if w > 0.0 else 0.0) - p) / w
            if out < exit_z:
                exit_z, exit_axis = out, axis
        steps.append(step)
        strides.append(step * stride)
    length = math.sqrt(way[0] * way[0] + way[1] * way[1] + way[2] * way[2])
    tx, ty, tz = nexts
    dx, dy, dz = ends
    sx, sy, sz = strides
    z, first = 0.0, index
    while True:
        if tx <= ty and tx <= tz:
            ahead, after, stride = tx, tx + dx, 0
        elif ty <= tz:
            ahead, after, stride = ty, ty + dy, 1
        else:
            ahead, after, stride = tz, tz + dz, 2
        if ahead >= exit_z - ROUNDING_M or ahead > FARTHEST_M:
            break
        if stride == 0:
            tx, index = after, index + sx
        elif stride == 1:
            ty, index = after, index + sy
        else:
            tz, index = after, index + sz
        z = ahead
        # On the floor and the walls the plane itself is what stops the ray: their cells are known to be there.
        if index in stops and index != first:
            return index, z, ALONE_COS
    if exit_z > FARTHEST_M or (exit_axis == 2 and steps[2] > 0):
        return None
    return index, exit_z, abs(way[exit_axis]) / length


def gain(adds: Mapping[int, int], grid: Grid, cells: Mapping[int, int]) -> int:
    """By how many wanted cells, in thousandths, a view brings the map nearer to what is wanted:
    sum of min((I + dI) / I_goal, 1) - min(I / I_goal, 1)."""
    total, goal = 0, grid.goal
    for number, weight in adds.items():
        if number in grid.wanted or is_inner(number, grid):
            have = cells.get(number, 0)
            total += min(have + weight, goal) - min(have, goal)
    return 1000 * total // goal
