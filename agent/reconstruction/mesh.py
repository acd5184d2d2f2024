"""The surface in a grid of signed distances as triangles: their vertices, colours, and what a camera sees of them.

The triangles are those of naive surface nets (Gibson 1998). Each cube of eight cells with a change of sign between them
has one vertex, the mean of the places on its edges where the distance is zero; each such edge joins the vertices of the
four cubes around it by two triangles. An edge counts if both of its cells are known well enough (LEAST_WEIGHT) and do
not contradict each other (MOST_JUMP_M, the far side of something thin).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.bricks import SIDE, Surface, balls_of, cone, cones, kernel, touched, touches
from agent.reconstruction.views import Camera, Floats, Stack, camera_in, inlined, pixel_of

LEAST_WEIGHT = 0.2  # one depth with a sigma of 22 mm
MOST_JUMP_M = 60e-3


class Mesh(NamedTuple):
    """World frame; counter-clockwise seen from the water."""

    vertices_m: Floats  # (n, 3)
    faces: NDArray[np.int32]  # (m, 3)
    normals: NDArray[np.float32]  # (n, 3) into the water
    colours: NDArray[np.float32]  # (n, 3) linear, red green blue; grey until `coloured`
    sigma_m: NDArray[np.float32]  # (n,) standard deviation, were views independent
    views: NDArray[np.uint8]  # (n,) how many saw it; 0: none, it was concluded from what lies around it


def seen_faces(mesh: Mesh) -> NDArray[np.int32]:
    """The triangles (k, 3) of which no corner was concluded."""
    return np.ascontiguousarray(mesh.faces[(mesh.views > 0)[mesh.faces].all(axis=1)])


def mesh_of(surface: Surface) -> Mesh:
    """All of the surface; empty where there is none."""
    return _numbered_mesh(surface)[0]


def joined(seen: Surface, both: Surface) -> Mesh:
    """The mesh of `both`, which has all that `seen` has and more in the same table of places.

    What is of `seen` alone is as `mesh_of(seen)` has it, to the bit; the other vertices have no views.
    """
    first, its = _numbered_mesh(seen)
    mesh, numbers = _numbered_mesh(both)
    there = seen.table >= 0
    in_seen, in_both = its[seen.table[there]], numbers[both.table[there]]
    known = in_seen >= 0
    mesh.views[:] = 0
    for name in ("vertices_m", "normals", "sigma_m", "views"):
        getattr(mesh, name)[in_both[known]] = getattr(first, name)[in_seen[known]]
    return mesh


def _numbered_mesh(surface: Surface) -> tuple[Mesh, NDArray[np.int32]]:
    """And which vertex each cube (bricks, 8, 8, 8) has; -1: none."""
    places = np.argwhere(surface.table >= 0)
    numbers = np.full(surface.weight.shape, -1, np.int32)
    count = _number(surface, places, LEAST_WEIGHT, numbers)
    vertices, normals = np.zeros((count, 3)), np.zeros((count, 3), np.float32)
    weight, views = np.zeros(count, np.float32), np.zeros(count, np.uint8)
    _place(surface, places, LEAST_WEIGHT, numbers, vertices, normals, weight, views)
    faces = np.empty((6 * count, 3), np.int32)
    used = _join(surface, places, LEAST_WEIGHT, numbers, faces)
    sigma = np.sqrt(1e-4 / np.maximum(weight, 1e-6)).astype(np.float32)
    grey = np.full((count, 3), 0.5, np.float32)
    return Mesh(vertices, faces[:used].copy(), normals, grey, sigma, views), numbers


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


# --- colours of vertices: a mean over the views that see them, nearer and straighter ones first ---
#
# A view sees a vertex if its own depth there is that of the vertex, within BAND_M or three sigma. Weights are cos /
# z^2; a view that contradicts the mean of the others by more than OFF counts for less, as a reflection or the rim of
# something nearer does.

BAND_M = 12e-3
OFF = 0.05  # of the sensor's limit
ROUNDS = 2
MOST_VIEWS = 32  # that one vertex listens to
PIECE = 64  # vertices that are near each other, as those of one brick are: views are chosen for all of them


def coloured(mesh: Mesh, stack: Stack) -> Mesh:
    """The same, with colours as they reach the cameras through the water; grey where no view tells."""
    colours = np.full((len(mesh.vertices_m), 3), 0.5, np.float32)
    around = balls_of(mesh.vertices_m, PIECE)
    _colour(mesh.vertices_m, mesh.normals, around, stack, cones(stack, BAND_M), colours)
    return mesh._replace(colours=colours)


@kernel
def _colour(
    vertices: Floats, normals: NDArray[np.float32], around: Floats, stack: Stack, reach: Floats,
    colours: NDArray[np.float32],
) -> None:  # fmt: skip
    rgb, share = np.empty((MOST_VIEWS, 3)), np.empty(MOST_VIEWS)
    near, seen = np.empty(len(stack.cameras), np.int64), 0
    for number in range(len(vertices)):
        if number % PIECE == 0:
            piece, seen = number // PIECE, 0
            for n in range(len(near)):
                if touches(reach, n, around[piece, 0], around[piece, 1], around[piece, 2], around[piece, 3]):
                    near[seen] = n
                    seen += 1
        found = 0
        for m in range(seen):
            if found == MOST_VIEWS:
                break
            n = near[m]
            camera, r, t = camera_in(stack, n), stack.rotations[n], stack.positions_m[n]
            dx, dy, dz = vertices[number, 0] - t[0], vertices[number, 1] - t[1], vertices[number, 2] - t[2]
            px = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz
            py = r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
            pz = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
            u, v, before = pixel_of(camera, px, py, pz)
            if not (before and 0.0 <= u < camera.width - 1 and 0.0 <= v < camera.height - 1):
                continue
            row, col = int(v + 0.5), int(u + 0.5)
            depth, sigma = float(stack.depth_m[n, row, col]), float(stack.sigma_m[n, row, col])
            if not abs(depth - pz) < max(BAND_M, 3.0 * sigma):
                continue
            length = (dx * dx + dy * dy + dz * dz) ** 0.5
            cosine = -(normals[number, 0] * dx + normals[number, 1] * dy + normals[number, 2] * dz) / length
            if cosine < 0.05:
                continue
            i, j = int(v), int(u)
            down, across = v - i, u - j
            for channel in range(3):
                p = stack.pictures[n, :, :, channel]
                top = p[i, j] + across * (p[i, j + 1] - p[i, j])
                bottom = p[i + 1, j] + across * (p[i + 1, j + 1] - p[i + 1, j])
                rgb[found, channel] = top + down * (bottom - top)
            share[found] = cosine / (length * length)
            found += 1
        if found == 0:
            continue
        red, green, blue = 0.0, 0.0, 0.0
        for round_ in range(ROUNDS + 1):
            total, a, b, c_ = 0.0, 0.0, 0.0, 0.0
            for m in range(found):
                weight = share[m]
                if round_ > 0:
                    off2 = (rgb[m, 0] - red) ** 2 + (rgb[m, 1] - green) ** 2 + (rgb[m, 2] - blue) ** 2
                    weight /= 1.0 + off2 / (OFF * OFF)
                total += weight
                a, b, c_ = a + weight * rgb[m, 0], b + weight * rgb[m, 1], c_ + weight * rgb[m, 2]
            red, green, blue = a / total, b / total, c_ / total
        colours[number, 0], colours[number, 1], colours[number, 2] = red, green, blue


# --- the surface as a camera would see it ---
#
# Triangles are drawn into pixels, nearest first, with the bend of the real lens. They are as small as the cells they
# come from, a few pixels, so that edges are drawn straight.

NEAREST_M = 0.02  # triangles nearer than that are behind the lens's own window
RASTER_PIECE = 256  # triangles that follow one another lie near each other, as those of two bricks do


class Rendered(NamedTuple):
    picture: NDArray[np.float32]  # (height, width, 3) linear; 0 where there is nothing
    depth_m: NDArray[np.float32]  # (height, width) along the axis; NaN where there is nothing


def pieces_of(mesh: Mesh) -> Floats:
    """(m, 4) middle and radius of a ball around each RASTER_PIECE triangles, for `rendered`."""
    around = np.empty((-(-len(mesh.faces) // RASTER_PIECE), 4))
    _pieces(mesh.vertices_m, mesh.faces, around)
    return around


def rendered(
    mesh: Mesh,
    colours: NDArray[np.float32],
    camera: Camera,
    rotation: Floats,
    position_m: Floats,
    pieces: Floats | None = None,
) -> Rendered:
    """The mesh with these colours (n, 3) a vertex, seen from both sides.

    pieces: of `pieces_of`, where many views are rendered of one mesh; else they are made.
    """
    picture = np.zeros((camera.height, camera.width, 3), np.float32)
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    there = np.flatnonzero(touched(pieces_of(mesh) if pieces is None else pieces, cone(camera, rotation, position_m)))
    rotation = np.ascontiguousarray(rotation)
    _draw(
        camera, rotation, np.ascontiguousarray(position_m), mesh.vertices_m, mesh.faces, there, colours, picture, depth
    )
    return Rendered(picture, np.where(np.isfinite(depth), depth, np.nan).astype(np.float32))


@kernel
def _pieces(vertices: Floats, faces: NDArray[np.int32], around: Floats) -> None:
    for b in range(len(around)):
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for n in range(b * RASTER_PIECE, min((b + 1) * RASTER_PIECE, len(faces))):
            for corner in range(3):
                for k in range(3):
                    at = vertices[faces[n, corner], k]
                    low[k], high[k] = min(low[k], at), max(high[k], at)
        square = 0.0
        for k in range(3):
            around[b, k] = 0.5 * (low[k] + high[k])
            square += 0.25 * (high[k] - low[k]) ** 2
        around[b, 3] = square**0.5


@kernel
def _draw(
    camera: Camera, rotation: Floats, position: Floats, vertices: Floats, faces: NDArray[np.int32],
    pieces: NDArray[np.int64], colours: NDArray[np.float32],
    picture: NDArray[np.float32], depth: NDArray[np.float32],
) -> None:  # fmt: skip
    height, width = depth.shape
    u, v, z = np.empty(3), np.empty(3), np.empty(3)
    for piece in pieces:
        for n in range(piece * RASTER_PIECE, min((piece + 1) * RASTER_PIECE, len(faces))):
            if not _triangle_corners(camera, rotation, position, vertices, faces[n], u, v, z):
                continue
            area = (u[1] - u[0]) * (v[2] - v[0]) - (u[2] - u[0]) * (v[1] - v[0])
            if not abs(area) > 1e-9:
                continue
            left, right = max(int(np.ceil(u.min())), 0), min(int(np.floor(u.max())), width - 1)
            top, bottom = max(int(np.ceil(v.min())), 0), min(int(np.floor(v.max())), height - 1)
            a, b, c = faces[n, 0], faces[n, 1], faces[n, 2]
            for row in range(top, bottom + 1):
                for col in range(left, right + 1):
                    p = ((u[1] - col) * (v[2] - row) - (u[2] - col) * (v[1] - row)) / area
                    q = ((u[2] - col) * (v[0] - row) - (u[0] - col) * (v[2] - row)) / area
                    r = 1.0 - p - q
                    if p < -1e-9 or q < -1e-9 or r < -1e-9:
                        continue
                    p, q, r = p / z[0], q / z[1], r / z[2]
                    here = 1.0 / (p + q + r)
                    if here < depth[row, col]:
                        depth[row, col] = here
                        for channel in range(3):
                            light = p * colours[a, channel] + q * colours[b, channel] + r * colours[c, channel]
                            picture[row, col, channel] = here * light


@kernel
def _triangle_corners(
    camera: Camera, rotation: Floats, position: Floats, vertices: Floats, face: NDArray[np.int32],
    u: Floats, v: Floats, z: Floats,
) -> bool:  # fmt: skip
    """Pixels and depths of a triangle's corners, each (3,); whether all are before the camera."""
    r = rotation
    for k in range(3):
        i = face[k]
        dx, dy, dz = vertices[i, 0] - position[0], vertices[i, 1] - position[1], vertices[i, 2] - position[2]
        z[k] = r[0, 2] * dx + r[1, 2] * dy + r[2, 2] * dz
        if z[k] < NEAREST_M:
            return False
        x, y = r[0, 0] * dx + r[1, 0] * dy + r[2, 0] * dz, r[0, 1] * dx + r[1, 1] * dy + r[2, 1] * dz
        u[k], v[k], before = pixel_of(camera, x, y, z[k])
        if not before:
            return False
    return True
