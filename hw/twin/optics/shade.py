"""How bright each pixel is: albedo of the surface, light from above, and the water in between.

Linear radiance, 1 is a white diffuser at the water surface. Daylight alone, without cast shadows; hw.twin.optics.lamps
adds the light of lamps.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw.twin.optics.raycast import (
    CHESSBOARD_ID,
    FLOOR_ID,
    LEVELS,
    ONE,
    SIZE,
    SOLID_ID,
    F,
    Floats,
    Identities,
    View,
    along,
    at,
    inlined,
    kernel,
    map_row,
    ray,
)
from hw.twin.scene import SceneWater

HALF, QUARTER, TWO = np.float32(0.5), np.float32(0.25), np.float32(2)
WALL_LIGHT, SLOPE_LIGHT = np.float32(0.6), np.float32(0.4)  # a diffuse room gives 0.6 + 0.4 n_z
SQUARE_M = np.float32(0.02)  # chessboard
GRAIN = np.float32(0.4)  # contrast of the grain on it: without it a square's inside has nothing to focus on
STEEPEST = np.float32(0.25)  # cosine below which the mip level no longer follows: the floor would be all blur
LOD_UP = np.float32(1.5)  # texels in a pixel above which the next mip level is taken
LEVEL_START = np.cumsum(np.array([0] + [(SIZE >> level) ** 2 for level in range(LEVELS)]))
WRAPS = np.float32(64)  # periods added to texture coordinates, which keeps them positive
TO_UNIT = np.float32(1 / 255)
SECOND_FACE_M, THIRD_FACE_M = np.float32(0.13), np.float32(0.19)  # else faces mirror each other along their edges

PER_M = 512  # steps a metre of the two tables below
STEPS_PER_M = np.float32(PER_M)


class ShadingTables(NamedTuple):
    """What a pixel's light is looked up in; it does not change from frame to frame."""

    atlas: NDArray[np.uint8]  # raycast.atlas
    layer: NDArray[np.int64]  # (M,) per material
    texels_per_m: Floats  # (M,)
    dark: Floats  # (M, 3) albedo, blue green red
    light: Floats  # (M, 3)
    path: Floats  # (N, 6) per 1/PER_M of range: transmission, then veil
    day: Floats  # (N, 3) per 1/PER_M of depth: light from the surface
    pixel: F  # slope of one pixel in water with the lens at rest: it picks the mip level


@inlined
def look_up(atlas: NDArray[np.uint8], layer: int, s: F, t: F, texels: F) -> F:
    """Bilinear sample at (s, t) texels, from the mip level that suits a pixel `texels` wide; 0 to 1."""
    level, scale = 0, ONE
    while texels * scale > LOD_UP and level < LEVELS - 1:
        level += 1
        scale *= HALF
    side = SIZE >> level
    first = LEVEL_START[level]
    shift = WRAPS * np.float32(side) - HALF
    x, y = s * scale + shift, t * scale + shift
    i, j = int(x), int(y)
    fx, fy = x - np.float32(i), y - np.float32(j)
    left, right = i & (side - 1), (i + 1) & (side - 1)
    above, below = first + (j & (side - 1)) * side, first + ((j + 1) & (side - 1)) * side
    nw, ne = atlas[layer, np.uint64(above + left)], atlas[layer, np.uint64(above + right)]
    sw, se = atlas[layer, np.uint64(below + left)], atlas[layer, np.uint64(below + right)]
    north = np.float32(nw) + fx * (np.float32(ne) - np.float32(nw))
    south = np.float32(sw) + fx * (np.float32(se) - np.float32(sw))
    return (north + fy * (south - north)) * TO_UNIT


@inlined
def square_wave(x: F, footprint: F) -> F:
    """+1 and -1 by turns every SQUARE_M, averaged over a pixel `footprint` wide: edges keep their sub-pixel place."""
    phase = x / (TWO * SQUARE_M) + QUARTER
    inside = QUARTER - abs(phase - math.floor(phase) - HALF)  # signed distance to the edge, periods
    return max(-ONE, min(ONE, inside * np.float32(4) * SQUARE_M / footprint))


@kernel
def shade(
    view: View, tables: ShadingTables, x0: int, y0: int, depth: Floats, identity: Identities, picture: Floats
) -> None:
    """Fill picture (h, w, 3), blue green red, from what trace found for the same pixels."""
    camera, surface_m = view.camera, view.box[2]
    pixel = view.optics.slope / math.sqrt(view.optics.n_squared)  # slope of one pixel in water
    # The picture grows with the lens position. A mip level that followed would switch in the middle of a focus sweep,
    # and a surface that changes its texture seems to change its sharpness.
    at_rest = tables.pixel / pixel
    rays = np.empty((5, depth.shape[1]), np.float32)
    for row in range(depth.shape[0]):
        for col in range(depth.shape[1]):  # several pixels at once, which what follows forbids
            mx, my, a, b = ray(view.optics, x0 + col, y0 + row)
            u = depth[row, col]
            rays[0, col], rays[1, col] = mx, my
            rays[2, col], rays[3, col] = a + u * mx, b + u * my
            rays[4, col] = math.sqrt(ONE + mx * mx + my * my)
        for col in range(depth.shape[1]):
            u, who = depth[row, col], identity[row, col]
            mx, my, px, py, length = rays[0, col], rays[1, col], rays[2, col], rays[3, col], rays[4, col]
            z = at(camera[2], px, py, u)
            material = view.material[who]
            facing, footprint, grain = WALL_LIGHT, u * pixel, ONE
            across = footprint * at_rest  # with foreshortening
            if who < CHESSBOARD_ID:
                x, y = at(camera[0], px, py, u), at(camera[1], px, py, u)
                if who < 2:
                    s, t, normal = y, z, along(camera[0], mx, my)
                elif who < FLOOR_ID:
                    s, t, normal = x, z, along(camera[1], mx, my)
                else:
                    s, t, normal = x, y, along(camera[2], mx, my)
                    facing = ONE
                across /= max(abs(normal) / length, STEEPEST)
            elif who == CHESSBOARD_ID:
                s, t = at(view.chessboard[0], px, py, u), at(view.chessboard[1], px, py, u)
            else:
                s, t, facing = _on_solid(view, who - SOLID_ID, px, py, u)
            texels = tables.texels_per_m[material]
            tone = look_up(tables.atlas, tables.layer[material], s * texels, t * texels, across * texels)
            if who == CHESSBOARD_ID:
                grain = ONE + GRAIN * (tone - HALF)
                s, t = s + view.chessboard_half[0], t + view.chessboard_half[1]  # squares count from a corner
                tone = HALF + HALF * square_wave(s, footprint) * square_wave(t, footprint)
            path = tables.path[min(int(u * length * STEPS_PER_M), tables.path.shape[0] - 1)]
            day = tables.day[min(max(int((surface_m - z) * STEPS_PER_M), 0), tables.day.shape[0] - 1)]
            facing *= grain
            for c in range(3):
                dark = tables.dark[material, c]
                albedo = dark + tone * (tables.light[material, c] - dark)
                picture[row, col, c] = albedo * facing * day[c] * path[c] + path[c + 3]


@inlined
def _face(kx: F, ky: F, kz: F) -> tuple[F, F, F]:
    """Normal of the unit cube's face that a point is on, in the cube's axes."""
    x, y, z = abs(kx), abs(ky), abs(kz)
    if x > y and x > z:
        return math.copysign(ONE, kx), np.float32(0), np.float32(0)
    if y > z:
        return np.float32(0), math.copysign(ONE, ky), np.float32(0)
    return np.float32(0), np.float32(0), math.copysign(ONE, kz)


@inlined
def _on_solid(view: View, e: int, px: F, py: F, u: F) -> tuple[F, F, F]:
    """Texture coordinates [m] and light of a point on a solid: the face of the cube that it looks at."""
    kx = at(map_row(view.solids, e, 0), px, py, u)
    ky = at(map_row(view.solids, e, 1), px, py, u)
    kz = at(map_row(view.solids, e, 2), px, py, u)
    rx, ry, rz = view.radii[e, 0], view.radii[e, 1], view.radii[e, 2]
    nx, ny, nz = kx / rx, ky / ry, kz / rz
    if view.cubes[e]:
        nx, ny, nz = _face(kx, ky, kz)
    rise = view.up[e, 0] * nx + view.up[e, 1] * ny + view.up[e, 2] * nz
    facing = WALL_LIGHT + SLOPE_LIGHT * rise / math.sqrt(nx * nx + ny * ny + nz * nz)
    x, y, z = kx * rx, ky * ry, kz * rz
    s, t = x, y + THIRD_FACE_M
    if abs(kx) > abs(ky) and abs(kx) > abs(kz):
        s, t = y, z
    elif abs(ky) > abs(kz):
        s, t = x + SECOND_FACE_M, z
    return s + view.pattern[e, 0], t + view.pattern[e, 1], facing


# --- water ---
#
# I = J exp(-bD z) + Binf (1 - exp(-bB z)), per colour (Akkaynak and Treibitz, CVPR 2018).
#
# z is the length of the way through the water. bD, of the object's own light, and bB, of the veil, differ: the
# restoration that assumes one coefficient is wrong by construction, as it is in the sea. Colours are blue green red.

Colour = NDArray[np.float64]  # (3,)

# Diffuse attenuation 1/m of Jerlov's types in bands around 460, 535 and 610 nm
# (Jerlov 1976, table XXVII; types I to IB as revised by Austin and Petzold; integrated over the bands).
KD_PER_M = {
    "air": (0.0, 0.0, 0.0),
    "tap": (0.020, 0.063, 0.251),  # I: in a tank the grey veil of particles matters more than colour
    "pool": (0.037, 0.072, 0.258),  # IB
    "coastal": (0.367, 0.215, 0.348),  # 3C
    "turbid": (0.846, 0.507, 0.521),  # 7C
}

LOST = 0.4  # share of scattering that daylight does not survive; most of it goes on downwards
LEVEL_SHARE = 0.1  # of daylight that particles send level, per scattering; assumed


class Water(NamedTuple):
    """Coefficients 1/m per colour; `veil` is Binf as a share of the light at the surface."""

    down: Colour  # daylight with depth
    direct: Colour  # bD
    scatter: Colour  # bB
    veil: Colour  # Binf


def draw_water(water: SceneWater, rng: np.random.Generator) -> Water:
    """One tank's water: Kd <= bD <= the beam coefficient, and a veil that the literature's ranges allow."""
    kd = np.array(KD_PER_M[water.preset])
    direct, scatter, path_m, share = rng.uniform((1, 0.8, 1, 0.1), (1.8, 2.5, 8, 0.6))
    if water.absorption_per_m is not None and water.scattering_per_m is not None:
        a, b = np.array(water.absorption_per_m), np.array(water.scattering_per_m)
        return Water(down=a + LOST * b, direct=a + b, scatter=a + b, veil=LEVEL_SHARE * b / (a + b))
    clear = water.preset == "air"
    return Water(
        down=kd,
        direct=kd * direct,
        scatter=kd * scatter + (0.0 if clear else water.grey_per_m),
        veil=np.zeros(3) if clear else np.exp(-kd * path_m) * share,
    )


def transmission_and_veil(water: Water, range_m: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(..., 3) share of J that arrives over `range_m` (...), and (..., 3) veil in front of it."""
    z = np.asarray(range_m, float)[..., None]
    return np.exp(-water.direct * z), water.veil * -np.expm1(-water.scatter * z)


def daylight(water: Water, depth_m: ArrayLike) -> NDArray[np.float64]:
    """(..., 3) share of the light at the surface that is left at `depth_m` (...)."""
    return np.asarray(np.exp(-water.down * np.maximum(np.asarray(depth_m, float), 0.0)[..., None]))
