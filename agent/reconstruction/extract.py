"""The surface in a grid of signed distances as triangles: naive surface nets (Gibson 1998).

Each cube of eight cells with a change of sign between them has one vertex, the mean of the places on its edges where
the distance is zero; each such edge joins the vertices of the four cubes around it by two triangles. An edge counts if
both of its cells are known well enough (LEAST_WEIGHT) and do not contradict each other (MOST_JUMP_M, the far side of
something thin).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.bricks import SIDE, Surface, kernel
from agent.reconstruction.camera import Floats, inlined

LEAST_WEIGHT = 0.2  # one depth with a sigma of 22 mm
MOST_JUMP_M = 60e-3


class Mesh(NamedTuple):
    """World frame; counter-clockwise seen from the water."""

    vertices_m: Floats  # (n, 3)
    faces: NDArray[np.int32]  # (m, 3)
    normals: NDArray[np.float32]  # (n, 3) into the water
    colours: NDArray[np.float32]  # (n, 3) linear, red green blue; grey until colours.py has looked
    sigma_m: NDArray[np.float32]  # (n,) standard deviation, were views independent
    views: NDArray[np.uint8]  # (n,) how many saw it


def mesh_of(surface: Surface, least_weight: float = LEAST_WEIGHT) -> Mesh:
    """All of the surface; empty where there is none."""
    places = np.argwhere(surface.table >= 0)
    numbers = np.full(surface.weight.shape, -1, np.int32)
    count = _number(surface, places, least_weight, numbers)
    vertices, normals = np.zeros((count, 3)), np.zeros((count, 3), np.float32)
    weight, views = np.zeros(count, np.float32), np.zeros(count, np.uint8)
    _place(surface, places, least_weight, numbers, vertices, normals, weight, views)
    faces = np.empty((6 * count, 3), np.int32)
    used = _join(surface, places, least_weight, numbers, faces)
    sigma = np.sqrt(1e-4 / np.maximum(weight, 1e-6)).astype(np.float32)
    return Mesh(vertices, faces[:used].copy(), normals, np.full((count, 3), 0.5, np.float32), sigma, views)


@inlined
def _cell(surface: Surface, i: int, j: int, k: int) -> tuple[int, int, int, int]:
    """Brick (-1: none) and place in it of a cell."""
    bi, bj, bk = i // SIDE, j // SIDE, k // SIDE
    inside = 0 <= bi < surface.table.shape[0] and 0 <= bj < surface.table.shape[1] and 0 <= bk < surface.table.shape[2]
    b = surface.table[bi, bj, bk] if inside else -1
    return b, i - bi * SIDE, j - bj * SIDE, k - bk * SIDE


@kernel
def _corners(surface: Surface, i: int, j: int, k: int, least: float, distance: Floats) -> bool:
    """Distances of the cube whose lowest cell is (i, j, k) into (2, 2, 2), NaN: unknown; whether an edge crosses."""
    for a in range(2):
        for b in range(2):
            for c in range(2):
                brick, x, y, z = _cell(surface, i + a, j + b, k + c)
                known = brick >= 0 and surface.weight[brick, x, y, z] >= least
                distance[a, b, c] = surface.distance_m[brick, x, y, z] if known else np.nan
    crosses = False
    for a in range(2):
        for b in range(2):
            crosses = crosses or _crosses(distance[a, b, 0], distance[a, b, 1])
            crosses = crosses or _crosses(distance[a, 0, b], distance[a, 1, b])
            crosses = crosses or _crosses(distance[0, a, b], distance[1, a, b])
    return crosses


@inlined
def _crosses(p: float, q: float) -> bool:
    return (p > 0.0) != (q > 0.0) and abs(p - q) < MOST_JUMP_M  # NaN: the difference is not below


@kernel
def _number(surface: Surface, places: NDArray[np.int64], least: float, numbers: NDArray[np.int32]) -> int:
    count, distance = 0, np.empty((2, 2, 2))
    for n in range(len(places)):
        i0, j0, k0 = places[n, 0] * SIDE, places[n, 1] * SIDE, places[n, 2] * SIDE
        brick = surface.table[places[n, 0], places[n, 1], places[n, 2]]
        for i in range(SIDE):
            for j in range(SIDE):
                for k in range(SIDE):
                    if _corners(surface, i0 + i, j0 + j, k0 + k, least, distance):
                        numbers[brick, i, j, k] = count
                        count += 1
    return count


@kernel
def _place(
    surface: Surface, places: NDArray[np.int64], least: float, numbers: NDArray[np.int32],
    vertices: Floats, normals: NDArray[np.float32],
    weight: NDArray[np.float32], views: NDArray[np.uint8],
) -> None:  # fmt: skip
    distance = np.empty((2, 2, 2))
    for n in range(len(places)):
        i0, j0, k0 = places[n, 0] * SIDE, places[n, 1] * SIDE, places[n, 2] * SIDE
        brick = surface.table[places[n, 0], places[n, 1], places[n, 2]]
        for i in range(SIDE):
            for j in range(SIDE):
                for k in range(SIDE):
                    number = numbers[brick, i, j, k]
                    if number < 0:
                        continue
                    _corners(surface, i0 + i, j0 + j, k0 + k, least, distance)
                    count, x, y, z = 0, 0.0, 0.0, 0.0
                    gx, gy, gz = 0.0, 0.0, 0.0
                    for a in range(2):
                        for b in range(2):
                            p, q = distance[0, a, b], distance[1, a, b]
                            if _crosses(p, q):
                                count, x, y, z = count + 1, x + p / (p - q), y + a, z + b
                            gx += q - p if abs(q - p) < MOST_JUMP_M else 0.0
                            p, q = distance[a, 0, b], distance[a, 1, b]
                            if _crosses(p, q):
                                count, x, y, z = count + 1, x + a, y + p / (p - q), z + b
                            gy += q - p if abs(q - p) < MOST_JUMP_M else 0.0
                            p, q = distance[a, b, 0], distance[a, b, 1]
                            if _crosses(p, q):
                                count, x, y, z = count + 1, x + a, y + b, z + p / (p - q)
                            gz += q - p if abs(q - p) < MOST_JUMP_M else 0.0
                    vertices[number, 0] = surface.origin_m[0] + surface.cell_m * (i0 + i + x / count)
                    vertices[number, 1] = surface.origin_m[1] + surface.cell_m * (j0 + j + y / count)
                    vertices[number, 2] = surface.origin_m[2] + surface.cell_m * (k0 + k + z / count)
                    length = max((gx * gx + gy * gy + gz * gz) ** 0.5, 1e-12)
                    normals[number, 0], normals[number, 1], normals[number, 2] = gx / length, gy / length, gz / length
                    _attributes(surface, i0 + i, j0 + j, k0 + k, least, number, weight, views)


@inlined
def _attributes(
    surface: Surface, i: int, j: int, k: int, least: float, number: int,
    weight: NDArray[np.float32], views: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Over the cells of a cube that are known."""
    known, total = 0, 0.0
    for a in range(2):
        for b in range(2):
            for c in range(2):
                brick, x, y, z = _cell(surface, i + a, j + b, k + c)
                if brick < 0 or surface.weight[brick, x, y, z] < least:
                    continue
                known += 1
                total += surface.weight[brick, x, y, z]
                views[number] = max(views[number], surface.views[brick, x, y, z])
    weight[number] = total / known


@inlined
def _numbered(surface: Surface, numbers: NDArray[np.int32], i: int, j: int, k: int) -> int:
    brick, x, y, z = _cell(surface, i, j, k)
    return numbers[brick, x, y, z] if brick >= 0 else -1


@kernel
def _join(
    surface: Surface, places: NDArray[np.int64], least: float, numbers: NDArray[np.int32], faces: NDArray[np.int32]
) -> int:
    """Two triangles for each edge that crosses and has all four cubes around it; how many."""
    used = 0
    for n in range(len(places)):
        i0, j0, k0 = places[n, 0] * SIDE, places[n, 1] * SIDE, places[n, 2] * SIDE
        brick = surface.table[places[n, 0], places[n, 1], places[n, 2]]
        for x in range(SIDE):
            for y in range(SIDE):
                for z in range(SIDE):
                    if surface.weight[brick, x, y, z] < least:
                        continue
                    i, j, k = i0 + x, j0 + y, k0 + z
                    here = surface.distance_m[brick, x, y, z]
                    for axis in range(3):
                        di, dj, dk = int(axis == 0), int(axis == 1), int(axis == 2)
                        other, ox, oy, oz = _cell(surface, i + di, j + dj, k + dk)
                        if other < 0 or surface.weight[other, ox, oy, oz] < least:
                            continue
                        there = surface.distance_m[other, ox, oy, oz]
                        if not _crosses(here, there):
                            continue
                        # The two axes across, in an order that is right-handed with this one.
                        ui, uj, uk = dk, di, dj
                        vi, vj, vk = dj, dk, di
                        p = _numbered(surface, numbers, i, j, k)
                        q = _numbered(surface, numbers, i - ui, j - uj, k - uk)
                        r = _numbered(surface, numbers, i - ui - vi, j - uj - vj, k - uk - vk)
                        s = _numbered(surface, numbers, i - vi, j - vj, k - vk)
                        if p < 0 or q < 0 or r < 0 or s < 0:
                            continue
                        if there > here:  # the water lies along the axis
                            faces[used, 0], faces[used, 1], faces[used, 2] = p, q, r
                            faces[used + 1, 0], faces[used + 1, 1], faces[used + 1, 2] = p, r, s
                        else:
                            faces[used, 0], faces[used, 1], faces[used, 2] = p, r, q
                            faces[used + 1, 0], faces[used + 1, 1], faces[used + 1, 2] = p, s, r
                        used += 2
    return used
