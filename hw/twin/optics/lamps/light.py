"""Light of lamps on surfaces: from each lamp through the water to what a pixel shows, and from there to the camera.

What the water scatters on the way by less than 5 degrees still arrives, as does part of the rest, from all around: it
fills shadows, and is taken as if it came from the lamp's side. Lambert's law on all surfaces; that of the water, seen
from below, sends no lamp's light back.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.lamps.beam import Beams
from hw.twin.optics.lamps.scattered import OFFS, SURFACE_STEP_M, Floats, Scattering
from hw.twin.optics.lamps.veil import CELLS, HALF, PER_M, Grid, beam_at, in_shadow, place_in
from hw.twin.optics.raycast import (
    CHESSBOARD_ID,
    FLOOR_ID,
    ONE,
    SOLID_ID,
    SURFACE_ID,
    ZERO,
    F,
    Identities,
    View,
    at,
    inlined,
    kernel,
    map_row,
    ray,
)

INVERSE_PI = np.float32(1 / math.pi)
DIFFUSE_WALL, DIFFUSE_SLOPE = np.float32(0.6), np.float32(0.4)  # as in shade.py, whose light is divided out
PER_SURFACE = np.float32(1 / SURFACE_STEP_M)
NEAREST_M2 = np.float32(1e-3)


class Ways(NamedTuple):
    """Transmission by length, float32."""

    straight: Floats  # (n, 3) per 1/512 m, lamp to surface: light that goes on within 5 degrees
    image: Floats  # (n, 3) surface to camera: light that is not scattered at all, for it makes the picture


@inlined
def _normal(view: View, who: int, px: F, py: F, u: F) -> tuple[F, F, F, F]:
    """Outward normal, camera frame, of any length, and the light of a diffuse room that shade() has given it."""
    if who < CHESSBOARD_ID:
        axis = 0 if who < 2 else 1 if who < FLOOR_ID else 2
        row = view.camera[0] if axis == 0 else view.camera[1] if axis == 1 else view.camera[2]
        sign = -ONE if who == 1 or who == 3 or who == SURFACE_ID else ONE
        return sign * row[0], sign * row[1], sign * row[2], DIFFUSE_WALL if who < FLOOR_ID else ONE
    if who == CHESSBOARD_ID:
        row = view.chessboard[2]
        return row[0], row[1], row[2], DIFFUSE_WALL
    e = who - SOLID_ID
    sx, sy, sz = map_row(view.solids, e, 0), map_row(view.solids, e, 1), map_row(view.solids, e, 2)
    kx, ky, kz = at(sx, px, py, u), at(sy, px, py, u), at(sz, px, py, u)
    if view.cubes[e]:
        x, y, z = abs(kx), abs(ky), abs(kz)
        if x > y and x > z:
            kx, ky, kz = math.copysign(ONE, kx), ZERO, ZERO
        elif y > z:
            kx, ky, kz = ZERO, math.copysign(ONE, ky), ZERO
        else:
            kx, ky, kz = ZERO, ZERO, math.copysign(ONE, kz)
    rx, ry, rz = view.radii[e, 0], view.radii[e, 1], view.radii[e, 2]
    bx, by, bz = kx / rx, ky / ry, kz / rz  # in the body's axes
    rise = (view.up[e, 0] * bx + view.up[e, 1] * by + view.up[e, 2] * bz) / math.sqrt(bx * bx + by * by + bz * bz)
    return (
        kx * sx[0] + ky * sy[0] + kz * sz[0],
        kx * sx[1] + ky * sy[1] + kz * sz[1],
        kx * sx[2] + ky * sy[2] + kz * sz[2],
        DIFFUSE_WALL + DIFFUSE_SLOPE * rise,
    )


@kernel
def light_up(
    view: View,
    beams: Beams,
    water: Scattering,
    beam: Floats,
    ways: Ways,
    x0: int,
    y0: int,
    depth: Floats,
    identity: Identities,
    albedo: Floats,
    picture: Floats,
) -> None:
    """Add the lamps' light to picture (h, w, 3), W/m2/sr; albedo (h, w, 3) as shade() has drawn it without water in a
    room of light 1."""
    last, around = ways.straight.shape[0] - 1, water.surface
    farthest = around.shape[0] - 1
    for row in range(depth.shape[0]):
        for col in range(depth.shape[1]):
            who = identity[row, col]
            if who == SURFACE_ID:
                continue
            mx, my, a, b = ray(view.optics, x0 + col, y0 + row)
            u = depth[row, col]
            px, py = a + u * mx, b + u * my
            nx, ny, nz, room = _normal(view, who, px, py, u)
            itself = int(who) - SOLID_ID
            inverse_n = ONE / math.sqrt(nx * nx + ny * ny + nz * nz)
            e0 = e1 = e2 = ZERO
            for lamp in range(beams.power.shape[0]):
                lx, ly, lz = beams.place[lamp, 0], beams.place[lamp, 1], beams.place[lamp, 2]
                wx, wy, wz = px - lx, py - ly, u - lz
                facing = -(wx * nx + wy * ny + wz * nz)
                if facing <= ZERO:
                    continue
                r2 = max(wx * wx + wy * wy + wz * wz, NEAREST_M2)
                inverse = ONE / math.sqrt(r2)
                r = r2 * inverse
                cosine = (wx * beams.aim[lamp, 0] + wy * beams.aim[lamp, 1] + wz * beams.aim[lamp, 2]) * inverse
                scale = beams.power[lamp] * facing * inverse_n * inverse * inverse * inverse
                i = min(int(r * PER_SURFACE), farthest)
                j, up = place_in(math.sqrt(max(HALF - HALF * cosine, ZERO)) * np.float32(OFFS - 1), OFFS)
                s0 = around[i, j, 0] + up * (around[i, j + 1, 0] - around[i, j, 0])
                s1 = around[i, j, 1] + up * (around[i, j + 1, 1] - around[i, j, 1])
                s2 = around[i, j, 2] + up * (around[i, j + 1, 2] - around[i, j, 2])
                shining = beam_at(cosine, beam)
                if shining > ZERO and not in_shadow(beams, lamp, wx, wy, wz, itself):
                    n = min(int(r * PER_M), last)
                    s0 += shining * ways.straight[n, 0]
                    s1 += shining * ways.straight[n, 1]
                    s2 += shining * ways.straight[n, 2]
                e0 += scale * s0
                e1 += scale * s1
                e2 += scale * s2
            n = min(int(u * math.sqrt(ONE + mx * mx + my * my) * PER_M), last)
            back = INVERSE_PI / room
            picture[row, col, 0] += albedo[row, col, 0] * e0 * back * ways.image[n, 0]
            picture[row, col, 1] += albedo[row, col, 1] * e1 * back * ways.image[n, 1]
            picture[row, col, 2] += albedo[row, col, 2] * e2 * back * ways.image[n, 2]


@kernel
def add_veil(grid: Grid, veil: NDArray[np.float32], x0: int, y0: int, depth: Floats, picture: Floats) -> None:
    """Add to each pixel the veil in front of it."""
    per_cell = np.float32(CELLS) / np.float32(grid.far_m)
    inverse = ONE / np.float32(grid.step)
    for row in range(depth.shape[0]):
        y = np.float32(np.int32(y0 + row - grid.y0)) * inverse
        j = min(int(y), grid.rows - 2)
        fy = y - np.float32(j)
        for col in range(depth.shape[1]):
            x = np.float32(np.int32(x0 + col - grid.x0)) * inverse
            i = min(int(x), grid.columns - 2)
            fx = x - np.float32(i)
            k, fz = place_in(depth[row, col] * per_cell, CELLS + 1)
            nw, ne = (ONE - fx) * (ONE - fy), fx * (ONE - fy)
            sw, se = (ONE - fx) * fy, fx * fy
            for c in range(3):
                near = nw * veil[j, i, k, c] + ne * veil[j, i + 1, k, c]
                near += sw * veil[j + 1, i, k, c] + se * veil[j + 1, i + 1, k, c]
                far = nw * veil[j, i, k + 1, c] + ne * veil[j, i + 1, k + 1, c]
                far += sw * veil[j + 1, i, k + 1, c] + se * veil[j + 1, i + 1, k + 1, c]
                picture[row, col, c] += near + fz * (far - near)
