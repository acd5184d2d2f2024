"""What lies between two views: how a window of one, tilted as its depths are, is carried into the other's picture."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.camera import Camera, Floats, inlined, pixel_of, slopes_of
from agent.reconstruction.stack import Stack, camera_in
from hw.compiled import compiled

ENDLESS_PX = 1e3  # beside a camera pixels go to infinity


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


@inlined
def most_shift_px(
    stack: Stack, mine: Camera, others: NDArray[np.int64], turns: Floats, shifts: Floats, pixel: tuple[float, float],
    near: float, far: float,
) -> float:  # fmt: skip
    """How far what is at a pixel goes in any other view's picture from one 1/z to another; ENDLESS_PX at most."""
    x, y = slopes_of(mine, pixel[0], pixel[1])
    a, b = 1.0 / near - mine.ahead_m, 1.0 / far - mine.ahead_m
    most_px = 0.0
    for k in range(len(others)):
        if others[k] < 0:
            break
        its = camera_in(stack, others[k])
        u0, v0, good0 = seen_at(its, turns[k], shifts[k], x * a, y * a, 1.0 / near)
        u1, v1, good1 = seen_at(its, turns[k], shifts[k], x * b, y * b, 1.0 / far)
        if good0 and good1:
            most_px = max(most_px, min(math.hypot(u1 - u0, v1 - v0), ENDLESS_PX))
    return most_px


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
