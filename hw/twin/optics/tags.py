"""AprilTags in the picture: the squares of the family 36h11, painted over the faces that they are on.

16 samples a pixel, of which no two lie in one row or column, say how much of it is which square: edges along rows and
columns keep their place to 1/32 px, others to 0.06 px rms at worst. Within a pixel the tag's plane is taken for linear.
A tag is paint on its face: as far away, as lit and as blurred as the face is there. The paper has a grain, so that the
insides of its squares have a focus.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.lens import Lens
from hw.twin.optics.raycast import (
    CHESSBOARD,
    FLOOR_ID,
    MATERIALS,
    ONE,
    TINY,
    ZERO,
    Affine,
    Ellipsoid,
    Eye,
    F,
    Floats,
    Identities,
    View,
    affine,
    along,
    at,
    inlined,
    kernel,
    map_row,
    pixel_bounds,
    ray,
    relative,
)
from hw.twin.optics.shade import GRAIN, HALF, STEEPEST, STEPS_PER_M, WALL_LIGHT, ShadingTables, look_up
from hw.twin.truth import PaintedTag

CODE, BORDER, SIDE = 6, 8, 10  # squares a side: of the code, with the black border, with the white margin around that
REACH = SIDE / BORDER / math.sqrt(2)  # sizes of a tag from its middle to a corner of its margin
BEYOND_CORNER = 1.3  # times the way to a corner of the picture: no lens draws what is farther out into it
PAPER = MATERIALS.index(CHESSBOARD)  # the same ink on the same grain
FACE_IDS = {"x0": 0, "x1": 1, "y0": 2, "y1": 3, "floor": FLOOR_ID}
SAMPLES = 16
SIXTEENTH, SIDE_SQUARES = np.float32(1 / SAMPLES), np.float32(SIDE)
BEYOND = np.float32(5)  # squares that a pixel whose middle misses the tag may lie off it: a tag so small is a dot
SHIFT = 64  # squares added before a whole number is taken, so that it is rounded down
OFFSET = np.float32(SHIFT)


class Decals(NamedTuple):
    """Tags as one camera sees them."""

    maps: Floats  # (T, 3, 4) camera to squares: to the right and down from the margin's upper left corner, and out
    square_m: Floats  # (T,) side of a square
    white: NDArray[np.uint8]  # (T, SIDE, SIDE) 1 is white, rows from the top
    face: NDArray[np.uint8]  # (T,) identity of the surface that it is on
    bounds: NDArray[np.int64]  # (T, 4) as View.bounds


@lru_cache(maxsize=1)
def family() -> NDArray[np.uint8]:
    """(587, SIDE, SIDE) the squares of every tag, rows from the top: 1 is white."""
    text = (resources.files("hw.twin.optics") / "tag36h11.txt").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    codes = np.array([int(word, 16) for line in lines for word in line.split()])
    white = np.ones((len(codes), SIDE, SIDE), np.uint8)
    white[:, 1:-1, 1:-1] = 0
    bits = codes[:, None] >> np.arange(CODE**2 - 1, -1, -1) & 1
    white[:, 2:-2, 2:-2] = bits.reshape(-1, CODE, CODE)
    return white


def make_decals(tags: Sequence[PaintedTag], eye: Eye, image_distance_m: float, lens: Lens, index: float) -> Decals:
    """Those of `tags` that may be in the picture, in the terms of the camera at `eye`; the other arguments as for
    make_view."""
    camera = affine(eye.rotation, eye.position_m)
    focal_px = index * image_distance_m / lens.pixel_m
    tags = _in_sight(tags, camera, focal_px, lens)
    maps, bounds = np.empty((len(tags), 3, 4)), np.empty((len(tags), 4), np.int64)
    for k, tag in enumerate(tags):
        to_tag = relative(tag.rotation, tag.position_m, camera) / (tag.size_m / BORDER)
        maps[k] = to_tag * np.array([[1.0], [-1.0], [1.0]])
        maps[k, :2, 3] += SIDE / 2
        around = Ellipsoid(tag.position_m, np.eye(3), (tag.size_m * REACH,) * 3, PAPER)
        bounds[k] = pixel_bounds(around, camera, lens, focal_px)
    return Decals(
        maps=maps.astype(np.float32),
        square_m=np.array([tag.size_m / BORDER for tag in tags], np.float32),
        white=family()[[tag.id for tag in tags]],
        face=np.array([FACE_IDS[tag.face] for tag in tags], np.uint8),
        bounds=bounds,
    )


def _in_sight(tags: Sequence[PaintedTag], camera: Affine, focal_px: float, lens: Lens) -> list[PaintedTag]:
    """Without those that are surely beside the picture or behind the camera: each one costs as much as a stone."""
    away_m = np.array([tag.position_m for tag in tags]).reshape(-1, 3) - camera[:, 3]
    range_m = np.linalg.norm(away_m, axis=1)
    half = np.arcsin(np.minimum(np.array([tag.size_m * REACH for tag in tags]) / np.maximum(range_m, 1e-9), 1.0))
    off_axis = np.arccos(np.clip(away_m @ camera[:, 2] / np.maximum(range_m, 1e-9), -1.0, 1.0)) - half
    u, v = (max(c, size - c) for c, size in zip(lens.centre_px, (lens.width, lens.height), strict=True))
    corner = math.atan(BEYOND_CORNER * math.hypot(u, v) / focal_px)
    return [tag for tag, off in zip(tags, off_axis, strict=True) if off < corner]


@kernel
def paint(
    view: View,
    tables: ShadingTables,
    decals: Decals,
    x0: int,
    y0: int,
    depth: Floats,
    identity: Identities,
    picture: Floats,
) -> None:
    """Add the tags to what shade made of the same pixels."""
    pixel = view.optics.slope / math.sqrt(view.optics.n_squared)  # slope of one pixel in water
    for k in range(decals.maps.shape[0]):
        right, down, out = map_row(decals.maps, k, 0), map_row(decals.maps, k, 1), map_row(decals.maps, k, 2)
        face, bounds, square_m, white = decals.face[k], decals.bounds[k], decals.square_m[k], decals.white[k]
        facing = ONE if face == FLOOR_ID else WALL_LIGHT
        scale = square_m * tables.texels_per_m[PAPER]
        for row in range(max(bounds[1] - y0, 0), min(bounds[3] - y0, depth.shape[0])):
            for col in range(max(bounds[0] - x0, 0), min(bounds[2] - x0, depth.shape[1])):
                if identity[row, col] != face:
                    continue
                mx, my, a, b = ray(view.optics, x0 + col, y0 + row)
                speed = along(out, mx, my)
                speed = speed if abs(speed) > TINY else TINY
                u = -at(out, a, b, ZERO) / speed
                px, py = a + u * mx, b + u * my
                s, t = at(right, px, py, u), at(down, px, py, u)
                if u < ZERO or min(s, t) < -BEYOND or max(s, t) > SIDE_SQUARES + BEYOND:
                    continue
                # To the next pixel the point moves by u pixel across, and along the ray by what keeps it on the plane.
                step, sx, sy = u * pixel, along(right, mx, my) / speed, along(down, mx, my) / speed
                to_right = (step * (right[0] - out[0] * sx), step * (down[0] - out[0] * sy))
                to_below = (step * (right[1] - out[1] * sx), step * (down[1] - out[1] * sy))
                share, bright = _cover(white, s, t, to_right, to_below)
                if share == ZERO:
                    continue
                length = math.sqrt(ONE + mx * mx + my * my)
                across = u * tables.pixel * tables.texels_per_m[PAPER]  # by the lens at rest, as shade has it
                across /= max(abs(speed) * square_m / length, STEEPEST)
                grain = look_up(tables.atlas, tables.layer[PAPER], s * scale, t * scale, across)
                lit = facing * (ONE + GRAIN * (grain - HALF))
                path = tables.path[min(int(u * length * STEPS_PER_M), tables.path.shape[0] - 1)]
                depth_m = view.box[2] - at(view.camera[2], px, py, u)
                day = tables.day[min(max(int(depth_m * STEPS_PER_M), 0), tables.day.shape[0] - 1)]
                for c in range(3):
                    dark = tables.dark[PAPER, c]
                    albedo = dark + bright / share * (tables.light[PAPER, c] - dark)
                    radiance = albedo * lit * day[c] * path[c] + path[c + 3]
                    picture[row, col, c] += share * (radiance - picture[row, col, c])


@inlined
def _cover(white: Identities, s: F, t: F, to_right: tuple[F, F], to_below: tuple[F, F]) -> tuple[F, F]:
    """Shares of a pixel that are tag and white tag: its middle is at (s, t) squares, its neighbours so much further."""
    s, t = s + OFFSET, t + OFFSET
    s_reach, t_reach = HALF * (abs(to_right[0]) + abs(to_below[0])), HALF * (abs(to_right[1]) + abs(to_below[1]))
    left, right = int(s - s_reach) - SHIFT, int(s + s_reach) - SHIFT
    top, bottom = int(t - t_reach) - SHIFT, int(t + t_reach) - SHIFT
    if right < 0 or left >= SIDE or bottom < 0 or top >= SIDE:
        return ZERO, ZERO
    if left >= 0 and right < SIDE and top >= 0 and bottom < SIDE and right - left < 2 and bottom - top < 2:
        count = white[top, left] + white[top, right] + white[bottom, left] + white[bottom, right]
        if count == 0:
            return ONE, ZERO
        if count == 4:
            return ONE, ONE
    share, bright = ZERO, ZERO
    for k in range(SAMPLES):
        x = (np.float32(k) + HALF) * SIXTEENTH - HALF
        y = (np.float32(4 * (k & 3) + (k >> 2)) + HALF) * SIXTEENTH - HALF
        i = int(s + x * to_right[0] + y * to_below[0]) - SHIFT
        j = int(t + x * to_right[1] + y * to_below[1]) - SHIFT
        if i >= 0 and i < SIDE and j >= 0 and j < SIDE:
            share += SIXTEENTH
            bright += SIXTEENTH * np.float32(white[j, i])
    return share, bright
