"""Where the blocks of a picture look, by + - * / and square roots alone: alike on every processor."""

from __future__ import annotations

import math

from agent.core.capability_messages import BEND_ONE, PX_ONE, TURN_ONE, UNIT_M, Lens, Place, Quaternion
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Rotation

UNBEND = 8  # passes that take the bend out of a slope, as in ranging/camera_model.py
Slopes = tuple[tuple[float, float], ...]


def block_slopes(lens: Lens, count: int) -> Slopes:
    """(x, y) / (z - ahead) of the middle of each block, row by row."""
    return tuple(slope(lens, k % lens.cols + 0.5, k // lens.cols + 0.5) for k in range(count))


def slope(lens: Lens, col: float, row: float) -> tuple[float, float]:
    """Of a place in the grid, counted in blocks from its upper left corner."""
    f, bend = lens.f / PX_ONE, lens.bend / BEND_ONE
    seen_x, seen_y = (col * lens.block - lens.cx / PX_ONE) / f, (row * lens.block - lens.cy / PX_ONE) / f
    x, y = seen_x, seen_y
    for _ in range(UNBEND):
        stretch = 1.0 + bend * (x * x + y * y)
        stretch = max(stretch, 0.1)
        x, y = seen_x / stretch, seen_y / stretch
    return x, y


def rotation(turn: Quaternion) -> Rotation:
    """Camera to world, of a quaternion times any factor."""
    w, x, y, z = (float(q) / TURN_ONE for q in turn)
    two = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)),
        (two * (x * y + w * z), 1.0 - two * (x * x + z * z), two * (y * z - w * x)),
        (two * (x * z - w * y), two * (y * z + w * x), 1.0 - two * (x * x + y * y)),
    )


def quaternion(r: Rotation) -> Quaternion:
    """The turn as it travels, w not negative (Shepperd 1978: the largest component first)."""
    (a, b, c), (d, e, f), (g, h, i) = r
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    most = max(range(4), key=lambda k: squares[k])
    s = 0.5 / math.sqrt(squares[most])
    found = (
        (0.25 / s, (h - f) * s, (c - g) * s, (d - b) * s),
        ((h - f) * s, 0.25 / s, (b + d) * s, (c + g) * s),
        ((c - g) * s, (b + d) * s, 0.25 / s, (f + h) * s),
        ((d - b) * s, (c + g) * s, (f + h) * s, 0.25 / s),
    )[most]
    sign = -1.0 if found[0] < 0.0 else 1.0
    w, x, y, z = (round(sign * q * TURN_ONE) for q in found)
    return w, x, y, z


def place_m(place: Place) -> Vector:
    x, y, z = (at * UNIT_M for at in place)
    return x, y, z


def along(r: Rotation, s: tuple[float, float]) -> Vector:
    """World direction of a slope, per metre of depth."""
    x, y = s
    return (
        r[0][0] * x + r[0][1] * y + r[0][2],
        r[1][0] * x + r[1][1] * y + r[1][2],
        r[2][0] * x + r[2][1] * y + r[2][2],
    )
