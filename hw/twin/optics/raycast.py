"""Rays through the port into the tank: which surface each pixel meets, and how far away.

The flat port is exact: a pixel's ray bends at the window, so rays do not meet in one point. Written as
P(u) = (a, b, 0) + u (mx, my, 1) in the camera frame, the parameter u is the z-depth from the optical centre and
(a, b) is the shift by which the refracted ray misses it. An agent that calibrates a pinhole is a little wrong,
as it is in the world.

Everything is float32: one float64 constant would promote a whole expression, hence the names for numbers. What does
not change inside a loop is a tuple: an array might overlap with the result, and would be read again for each pixel.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.compiled import compiled

Floats = NDArray[np.float32]
Identities = NDArray[np.uint8]  # of the surface that a pixel shows
F = Any  # a float32 scalar inside a kernel
Row = tuple[F, F, F, F]  # of an affine map: three factors and a shift
Map = tuple[Row, Row, Row]

ZERO, ONE = np.float32(0), np.float32(1)
TINY = np.float32(1e-9)  # stands for a slope of zero
NEAREST_M = np.float32(1e-3)
FLOOR_ID, SURFACE_ID, CHESSBOARD_ID, SOLID_ID = 4, 5, 6, 7  # identities; below are walls, from SOLID_ID on ellipsoids

# numpy's error model: division by zero is inf, not an exception whose branch would forbid SIMD.
kernel = compiled(fastmath=True, error_model="numpy")
inlined = compiled(fastmath=True, error_model="numpy", inline="always")


class Optics(NamedTuple):
    """Pixels to rays, float32."""

    slope: F  # pixel pitch / v
    cx: F
    cy: F
    k1: F
    k2: F
    n_squared: F
    gap: F  # optical centre to port, m


class View(NamedTuple):
    """How one camera looks at the world at one instant."""

    optics: Optics
    camera: Map  # camera to world
    box: tuple[F, F, F]  # size of the water body
    chessboard: Map  # camera to chessboard
    chessboard_half: tuple[F, F]  # half size, 0: there is none
    solids: Floats  # (E, 3, 4) camera to the unit sphere of each ellipsoid
    bounds: NDArray[np.int64]  # (E, 4) no pixel of the ellipsoid lies outside x0 <= x < x1, y0 <= y < y1
    radii: Floats  # (E, 3) semi-axes
    up: Floats  # (E, 3) the world's z in the ellipsoid's axes
    cubes: NDArray[np.int64]  # (E,) 1: a box of these semi-axes, not an ellipsoid
    pattern: Floats  # (E, 2) where on its texture an ellipsoid has its middle, m
    material: NDArray[np.int64]  # (SOLID_ID + E,) row of texture.MATERIALS for each identity


@inlined
def ray(optics: Optics, i: int, j: int) -> tuple[F, F, F, F]:
    """Slopes mx, my in water and shifts a, b [m] of the ray through pixel (i, j)."""
    x = (np.float32(np.int32(i)) - optics.cx) * optics.slope
    y = (np.float32(np.int32(j)) - optics.cy) * optics.slope
    r2 = x * x + y * y
    stretch = ONE + r2 * (optics.k1 + optics.k2 * r2)
    x, y, r2 = x * stretch, y * stretch, r2 * stretch * stretch
    bend = ONE / math.sqrt(optics.n_squared * (ONE + r2) - r2)  # Snell for slopes: tan(in water) / tan(in air)
    shift = optics.gap * (ONE - bend)
    return x * bend, y * bend, x * shift, y * shift


@inlined
def along(row: Row, mx: F, my: F) -> F:
    """One coordinate of the direction (mx, my, 1) under a map."""
    return row[0] * mx + row[1] * my + row[2]


@inlined
def at(row: Row, x: F, y: F, z: F) -> F:
    """One coordinate of the point (x, y, z) under a map."""
    return row[0] * x + row[1] * y + row[2] * z + row[3]


@inlined
def map_row(maps: Floats, e: int, axis: int) -> Row:
    return (maps[e, axis, 0], maps[e, axis, 1], maps[e, axis, 2], maps[e, axis, 3])


@inlined
def exit_depth(row: Row, mx: F, my: F, a: F, b: F, size: F) -> tuple[F, Any]:
    """z-depth at which a ray from inside leaves the slab 0 to `size`, and 1 if it leaves at `size`."""
    speed = along(row, mx, my)
    side = size if speed > ZERO else ZERO
    return (side - at(row, a, b, ZERO)) / (speed if abs(speed) > TINY else TINY), np.int32(speed > ZERO)


@kernel
def trace(view: View, x0: int, y0: int, depth: Floats, identity: Identities) -> None:
    """Fill z-depth [m] and identity (h, w) of the pixels from (x0, y0) of the full frame on."""
    for row in range(depth.shape[0]):
        for col in range(depth.shape[1]):
            mx, my, a, b = ray(view.optics, x0 + col, y0 + row)
            u, face = exit_depth(view.camera[0], mx, my, a, b, view.box[0])
            v, other = exit_depth(view.camera[1], mx, my, a, b, view.box[1])
            w, third = exit_depth(view.camera[2], mx, my, a, b, view.box[2])
            face = face if u < v else other + np.int32(2)
            u = min(u, v)
            face = face if u < w else third + np.int32(FLOOR_ID)
            depth[row, col] = max(min(u, w), NEAREST_M)
            identity[row, col] = face
    if view.chessboard_half[0] > ZERO:
        _trace_chessboard(view, x0, y0, depth, identity)
    for e in range(view.solids.shape[0]):
        if view.cubes[e]:
            _trace_cube(view, e, x0, y0, depth, identity)
        else:
            _trace_solid(view, e, x0, y0, depth, identity)


@kernel
def _trace_chessboard(view: View, x0: int, y0: int, depth: Floats, identity: Identities) -> None:
    board, half = view.chessboard, view.chessboard_half
    for row in range(depth.shape[0]):
        for col in range(depth.shape[1]):
            mx, my, a, b = ray(view.optics, x0 + col, y0 + row)
            speed = along(board[2], mx, my)
            u = -at(board[2], a, b, ZERO) / (speed if abs(speed) > TINY else TINY)
            if u > ZERO and u < depth[row, col]:
                x, y = a + u * mx, b + u * my
                if abs(at(board[0], x, y, u)) <= half[0] and abs(at(board[1], x, y, u)) <= half[1]:
                    depth[row, col] = u
                    identity[row, col] = CHESSBOARD_ID


@kernel
def _trace_solid(view: View, e: int, x0: int, y0: int, depth: Floats, identity: Identities) -> None:
    qx, qy, qz = map_row(view.solids, e, 0), map_row(view.solids, e, 1), map_row(view.solids, e, 2)
    bounds = view.bounds[e]
    for row in range(max(bounds[1] - y0, 0), min(bounds[3] - y0, depth.shape[0])):
        for col in range(max(bounds[0] - x0, 0), min(bounds[2] - x0, depth.shape[1])):
            mx, my, a, b = ray(view.optics, x0 + col, y0 + row)
            dx, dy, dz = along(qx, mx, my), along(qy, mx, my), along(qz, mx, my)
            px, py, pz = at(qx, a, b, ZERO), at(qy, a, b, ZERO), at(qz, a, b, ZERO)
            dd = dx * dx + dy * dy + dz * dz
            dp = dx * px + dy * py + dz * pz
            root = dp * dp - dd * (px * px + py * py + pz * pz - ONE)
            if root > ZERO:
                u = (-dp - math.sqrt(root)) / dd
                if u > ZERO and u < depth[row, col]:
                    depth[row, col] = u
                    identity[row, col] = SOLID_ID + e


@inlined
def enter_and_leave(speed: F, start: F) -> tuple[F, F]:
    """z-depths at which a ray enters and leaves the slab from -1 to 1."""
    speed = speed if abs(speed) > TINY else TINY
    first, second = (-ONE - start) / speed, (ONE - start) / speed
    return min(first, second), max(first, second)


@kernel
def _trace_cube(view: View, e: int, x0: int, y0: int, depth: Floats, identity: Identities) -> None:
    qx, qy, qz = map_row(view.solids, e, 0), map_row(view.solids, e, 1), map_row(view.solids, e, 2)
    bounds = view.bounds[e]
    for row in range(max(bounds[1] - y0, 0), min(bounds[3] - y0, depth.shape[0])):
        for col in range(max(bounds[0] - x0, 0), min(bounds[2] - x0, depth.shape[1])):
            mx, my, a, b = ray(view.optics, x0 + col, y0 + row)
            in_x, out_x = enter_and_leave(along(qx, mx, my), at(qx, a, b, ZERO))
            in_y, out_y = enter_and_leave(along(qy, mx, my), at(qy, a, b, ZERO))
            in_z, out_z = enter_and_leave(along(qz, mx, my), at(qz, a, b, ZERO))
            u = max(in_x, max(in_y, in_z))
            if u < min(out_x, min(out_y, out_z)) and u > ZERO and u < depth[row, col]:
                depth[row, col] = u
                identity[row, col] = SOLID_ID + e
