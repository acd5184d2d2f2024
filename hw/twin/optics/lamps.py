"""All that lamps add to a picture, from the tables of one water."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.raycast import (
    CHESSBOARD_ID,
    FLOOR_ID,
    HULL_RADII_M,
    ONE,
    SOLID_ID,
    SURFACE_ID,
    ZERO,
    F,
    Floats,
    Identities,
    Moment,
    View,
    affine,
    at,
    inlined,
    kernel,
    map_row,
    ray,
    relative,
)
from hw.twin.optics.shade import ShadingTables
from hw.twin.optics.veil import (
    CELLS,
    HALF,
    OFFS,
    PER_M,
    SURFACE_STEP_M,
    Beams,
    Grid,
    Scattering,
    beam_at,
    beam_table,
    fill_veil,
    grid_for,
    in_shadow,
    make_beams,
    place_in,
    scattering,
)

# --- lamps of one moment ---

Part = tuple[int, int, int, int]  # x, y, width, height in the full frame

FAREST_M = 4.0  # z-depth that the veil is added up to; behind it as much lies in front of everything


class LampTables(NamedTuple):
    water: Scattering
    beam: Floats
    ways: Ways
    neutral: ShadingTables  # shade() draws albedo with it: no water, a room of light 1


def lamp_tables(
    absorption_per_m: tuple[float, ...], scattering_per_m: tuple[float, ...], shading: ShadingTables
) -> LampTables:
    """All orders of scattering."""
    water = scattering(absorption_per_m, scattering_per_m)
    extinct = np.asarray(absorption_per_m) + np.asarray(scattering_per_m)
    lengths = len(shading.path)
    ways = Ways(transmission(water.extinct, lengths), transmission(extinct, lengths))
    path = np.zeros_like(shading.path)
    path[:, :3] = 1
    return LampTables(water, beam_table(), ways, shading._replace(path=path, day=np.ones_like(shading.day)))


def transmission(extinct_per_m: NDArray[Any], lengths: int) -> Floats:
    """(lengths, 3) over n / PER_M metres."""
    length_m = np.arange(lengths)[:, None] / float(PER_M)
    return np.exp(-np.asarray(extinct_per_m, float) * length_m).astype(np.float32)


def beams_of(moment: Moment, view: View) -> Beams:
    """The moment's lamps, and what may throw shadows: all solids, hulls and creatures, and the camera's own robot."""
    camera = affine(moment.eye.rotation, moment.eye.position_m)
    bodies = [
        (np.asarray(s.position_m, float), max(s.radii_m) * (3**0.5 if s.kind == "box" else 1)) for s in moment.solids
    ]
    bodies += [(np.asarray(h.position_m, float), max(HULL_RADII_M)) for h in moment.hulls]
    bodies += [(np.asarray(p.position_m, float), max(p.radii_m)) for c in moment.creatures for p in c.parts]
    maps, cubes = view.solids.astype(float), view.cubes
    if moment.own_hull is not None:
        hull = moment.own_hull
        bodies.append((np.asarray(hull.position_m, float), max(HULL_RADII_M)))
        own = relative(hull.rotation, hull.position_m, camera) / np.array(HULL_RADII_M)[:, None]
        maps, cubes = np.concatenate([maps, own[None]]), np.append(cubes, 0)
    return make_beams(moment.lamps, camera, bodies, maps, cubes)


def add_lamps(
    tables: LampTables,
    moment: Moment,
    view: View,
    part: Part,
    full_width: int,
    depth: Floats,
    identity: Identities,
    albedo: Floats,
    picture: Floats,
) -> None:
    """Add light and veil of the moment's lamps to picture (h, w, 3), a part of the frame of which trace() has found
    depth and identity, and shade() with tables.neutral the albedo."""
    beams = beams_of(moment, view)
    x, y = part[:2]
    light_up(view, beams, tables.water, tables.beam, tables.ways, x, y, depth, identity, albedo, picture)
    grid = grid_for(part, full_width, min(float(depth.max()), FAREST_M))
    veil: NDArray[np.float32] = np.empty((grid.rows, grid.columns, CELLS + 1, 3), np.float32)
    fill_veil(view.optics, beams, tables.water, tables.beam, tables.ways.straight, grid, veil)
    add_veil(grid, veil, x, y, depth, picture)


# --- light on surfaces: from each lamp through the water to what a pixel shows, and from there to the camera ---
#
# What the water scatters on the way by less than 5 degrees still arrives, as does part of the rest, from all around:
# it fills shadows, and is taken as if it came from the lamp's side. Lambert's law on all surfaces; that of the water,
# seen from below, sends no lamp's light back.

INVERSE_PI = np.float32(1 / math.pi)
DIFFUSE_WALL, DIFFUSE_SLOPE = np.float32(0.6), np.float32(0.4)  # those of shade(), whose light is divided out
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
    farthest, width = around.shape[0] - 1, depth.shape[1]
    of_row, light = np.empty((10, width), np.float32), np.empty((3, width), np.float32)
    px, py, length, back = of_row[0], of_row[1], of_row[2], of_row[3]
    nx, ny, nz = of_row[4], of_row[5], of_row[6]
    ranges, cosines, scales = of_row[7], of_row[8], of_row[9]
    for row in range(depth.shape[0]):
        us, whos = depth[row], identity[row]
        for col in range(width):  # several pixels at once, which tables forbid
            mx, my, a, b = ray(view.optics, x0 + col, y0 + row)
            u = us[col]
            px[col], py[col] = a + u * mx, b + u * my
            length[col] = u * math.sqrt(ONE + mx * mx + my * my)
        for col in range(width):
            kx, ky, kz, room = _normal(view, whos[col], px[col], py[col], us[col])
            inverse = ONE / math.sqrt(kx * kx + ky * ky + kz * kz)
            nx[col], ny[col], nz[col], back[col] = kx * inverse, ky * inverse, kz * inverse, INVERSE_PI / room
            light[0, col] = light[1, col] = light[2, col] = ZERO
        for lamp in range(beams.power.shape[0]):
            lx, ly, lz = beams.place[lamp, 0], beams.place[lamp, 1], beams.place[lamp, 2]
            ax, ay, az = beams.aim[lamp, 0], beams.aim[lamp, 1], beams.aim[lamp, 2]
            power = beams.power[lamp]
            for col in range(width):
                wx, wy, wz = px[col] - lx, py[col] - ly, us[col] - lz
                facing = -(wx * nx[col] + wy * ny[col] + wz * nz[col])
                r2 = max(wx * wx + wy * wy + wz * wz, NEAREST_M2)
                inverse = ONE / math.sqrt(r2)
                ranges[col] = r2 * inverse
                cosines[col] = (wx * ax + wy * ay + wz * az) * inverse
                scales[col] = power * facing * inverse * inverse * inverse
            for col in range(width):
                scale, r, cosine = scales[col], ranges[col], cosines[col]
                if scale <= ZERO or whos[col] == SURFACE_ID:
                    continue
                i = min(int(r * PER_SURFACE), farthest)
                j, up = place_in(math.sqrt(max(HALF - HALF * cosine, ZERO)) * np.float32(OFFS - 1), OFFS)
                s0 = around[i, j, 0] + up * (around[i, j + 1, 0] - around[i, j, 0])
                s1 = around[i, j, 1] + up * (around[i, j + 1, 1] - around[i, j, 1])
                s2 = around[i, j, 2] + up * (around[i, j + 1, 2] - around[i, j, 2])
                shining = beam_at(cosine, beam)
                if shining > ZERO:
                    wx, wy, wz = px[col] - lx, py[col] - ly, us[col] - lz
                    if not in_shadow(beams, lamp, wx, wy, wz, int(whos[col]) - SOLID_ID):
                        n = min(int(r * PER_M), last)
                        s0 += shining * ways.straight[n, 0]
                        s1 += shining * ways.straight[n, 1]
                        s2 += shining * ways.straight[n, 2]
                light[0, col] += scale * s0
                light[1, col] += scale * s1
                light[2, col] += scale * s2
        for col in range(width):
            n = min(int(length[col] * PER_M), last)
            for c in range(3):
                picture[row, col, c] += albedo[row, col, c] * light[c, col] * back[col] * ways.image[n, c]


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
