"""What colour each vertex of a surface has: a mean over the views that see it, nearer and straighter ones first.

A view sees a vertex if its own depth there is that of the vertex, within BAND_M or three sigma. Weights are cos / z^2;
a view that contradicts the mean of the others by more than OFF counts for less, as a reflection or the rim of something
nearer does.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.bricks import kernel
from agent.reconstruction.camera import Floats, pixel_of
from agent.reconstruction.extract import Mesh
from agent.reconstruction.reach import balls_of, cones, touches
from agent.reconstruction.stack import Stack, camera_in

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
