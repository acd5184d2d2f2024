"""A surface as a camera would see it: triangles into pixels, nearest first, with the bend of the real lens.

Triangles are as small as the cells they come from, a few pixels, so that edges are drawn straight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.bricks import kernel
from agent.reconstruction.camera import Camera, Floats, pixel_of
from agent.reconstruction.extract import Mesh
from agent.reconstruction.reach import cone, touched

NEAREST_M = 0.02  # triangles nearer than that are behind the lens's own window
RASTER_PIECE = 256  # triangles that follow one another lie near each other, as those of two bricks do


class Rendered(NamedTuple):
    picture: NDArray[np.float32]  # (height, width, 3) linear; 0 where there is nothing
    depth_m: NDArray[np.float32]  # (height, width) along the axis; NaN where there is nothing


def pieces_of(mesh: Mesh) -> Floats:
    """(m, 4) middle and radius of a ball around each PIECE triangles, for `rendered`."""
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
    """The mesh with these colours (n, 3) a vertex, seen from both sides. pieces: of `pieces_of`, where many views are
    rendered of one mesh; else they are made."""
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
