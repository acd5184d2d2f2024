"""What lies between two views: how a window of one, tilted as its depths are, is carried into the other's picture."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Camera, Floats, inlined, pixel_of
from agent.reconstruction.stack import Stack
from hw.compiled import compiled


@compiled(error_model="numpy")
def slopes_of_map(depth: NDArray[np.float32], tilt: Floats) -> None:
    """How 1/z changes with a pixel to the right and down (height, width, 2), over 9 x 9 pixels; 0 where unknown."""
    for row in range(depth.shape[0]):
        for col in range(depth.shape[1]):
            n, su, sv, sq = 0, 0.0, 0.0, 0.0
            suu, suv, svv, suq, svq = 0.0, 0.0, 0.0, 0.0, 0.0
            tilt[row, col, 0] = tilt[row, col, 1] = 0.0
            if not depth[row, col] > 0.0:
                continue
            middle = 1.0 / depth[row, col]
            for i in range(max(row - 4, 0), min(row + 5, depth.shape[0]), 2):
                for j in range(max(col - 4, 0), min(col + 5, depth.shape[1]), 2):
                    q = 1.0 / depth[i, j] - middle
                    if not abs(q) < 0.1 * middle:
                        continue
                    u, v = float(j - col), float(i - row)
                    n, su, sv, sq = n + 1, su + u, sv + v, sq + q
                    suu, suv, svv, suq, svq = suu + u * u, suv + u * v, svv + v * v, suq + u * q, svq + v * q
            if n < 9:
                continue
            suu, suv, svv = suu - su * su / n, suv - su * sv / n, svv - sv * sv / n
            suq, svq = suq - su * sq / n, svq - sv * sq / n
            determinant = suu * svv - suv * suv
            if determinant > 1e-6 * suu * svv:
                tilt[row, col, 0] = (svv * suq - suv * svq) / determinant
                tilt[row, col, 1] = (suu * svq - suv * suq) / determinant


@inlined
def seen_at(camera: Camera, m: Floats, shift: Floats, x: float, y: float, z: float) -> tuple[float, float, bool]:
    """A point of one view's frame in another's picture, by the rotation (3, 3) and shift (3,) between them."""
    return pixel_of(
        camera,
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + shift[0],
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + shift[1],
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + shift[2],
    )


@compiled(error_model="numpy", fastmath={"contract", "arcp", "nsz"})
def between(stack: Stack, n: int, others: NDArray[np.int64], turns: Floats, shifts: Floats) -> None:
    """Rotation and shift from view n's frame into each other's."""
    for k in range(len(others)):
        o = others[k]
        if o < 0:
            continue
        for a in range(3):
            shifts[k, a] = 0.0
            for b in range(3):
                shifts[k, a] += stack.rotations[o, b, a] * (stack.positions_m[n, b] - stack.positions_m[o, b])
                turns[k, a, b] = 0.0
                for c in range(3):
                    turns[k, a, b] += stack.rotations[o, c, a] * stack.rotations[n, c, b]
