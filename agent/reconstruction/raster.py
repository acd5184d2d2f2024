"""A surface as a camera would see it: triangles into pixels, nearest first, with the bend of the real lens.

Triangles are as small as the cells they come from, a few pixels, so that edges are drawn straight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.bricks import kernel
from agent.reconstruction.camera import Camera, Floats, project
from agent.reconstruction.extract import Mesh

NEAREST_M = 0.02  # triangles nearer than that are behind the lens's own window


class Rendered(NamedTuple):
    picture: NDArray[np.float32]  # (height, width, 3) linear; 0 where there is nothing
    depth_m: NDArray[np.float32]  # (height, width) along the axis; NaN where there is nothing


def rendered(
    mesh: Mesh, colours: NDArray[np.float32], camera: Camera, rotation: Floats, position_m: Floats
) -> Rendered:
    """The mesh with these colours (n, 3) a vertex, seen from both sides."""
    there = (mesh.vertices_m - position_m) @ rotation
    pixels = np.ascontiguousarray(project(camera, there))
    picture = np.zeros((camera.height, camera.width, 3), np.float32)
    depth = np.full((camera.height, camera.width), np.inf, np.float32)
    _draw(pixels, np.ascontiguousarray(there[:, 2]), mesh.faces, colours, picture, depth)
    return Rendered(picture, np.where(np.isfinite(depth), depth, np.nan).astype(np.float32))


@kernel
def _draw(
    pixels: Floats, z: Floats, faces: NDArray[np.int32], colours: NDArray[np.float32],
    picture: NDArray[np.float32], depth: NDArray[np.float32],
) -> None:  # fmt: skip
    height, width = depth.shape
    for n in range(len(faces)):
        a, b, c = faces[n, 0], faces[n, 1], faces[n, 2]
        if z[a] < NEAREST_M or z[b] < NEAREST_M or z[c] < NEAREST_M:
            continue
        u0, v0, u1, v1, u2, v2 = pixels[a, 0], pixels[a, 1], pixels[b, 0], pixels[b, 1], pixels[c, 0], pixels[c, 1]
        area = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
        if not abs(area) > 1e-9:  # NaN, too: one corner is behind
            continue
        left, right = max(int(np.ceil(min(u0, u1, u2))), 0), min(int(np.floor(max(u0, u1, u2))), width - 1)
        top, bottom = max(int(np.ceil(min(v0, v1, v2))), 0), min(int(np.floor(max(v0, v1, v2))), height - 1)
        for row in range(top, bottom + 1):
            for col in range(left, right + 1):
                p = ((u1 - col) * (v2 - row) - (u2 - col) * (v1 - row)) / area
                q = ((u2 - col) * (v0 - row) - (u0 - col) * (v2 - row)) / area
                r = 1.0 - p - q
                if p < -1e-9 or q < -1e-9 or r < -1e-9:
                    continue
                p, q, r = p / z[a], q / z[b], r / z[c]
                here = 1.0 / (p + q + r)
                if here < depth[row, col]:
                    depth[row, col] = here
                    for channel in range(3):
                        light = p * colours[a, channel] + q * colours[b, channel] + r * colours[c, channel]
                        picture[row, col, channel] = here * light
