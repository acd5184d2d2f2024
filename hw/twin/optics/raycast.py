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
from collections.abc import Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw.compiled import compiled
from hw.twin.optics.lens import Lens
from hw.twin.scene import Solid, generator
from hw.twin.truth import PaintedTag

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
    material: NDArray[np.int64]  # (SOLID_ID + E,) row of MATERIALS for each identity


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


# --- textures: surfaces that a camera can focus on ---
#
# Periodic noise over all scales, with mip levels against aliasing.

SIZE = 1024  # texels a side, a power of two
LEVELS = 7  # the coarsest texel is 64 fine ones wide
TILED, MOTTLED, GRAINED, BLOTCHED = range(4)  # layers of the atlas; the last for scenes with creatures alone


class Material(NamedTuple):
    """Albedo between two colours (blue green red), as a layer of the atlas says."""

    layer: int
    texel_m: float
    dark: tuple[float, float, float]
    light: tuple[float, float, float]


WALL = Material(TILED, 0.8e-3, (0.17, 0.18, 0.18), (0.50, 0.52, 0.52))
FLOOR = Material(TILED, 0.8e-3, (0.22, 0.24, 0.22), (0.52, 0.56, 0.54))
SURFACE = Material(MOTTLED, 4e-3, (0.62, 0.62, 0.60), (0.95, 0.95, 0.95))  # bright from below, no mirror image
CHESSBOARD = Material(GRAINED, 0.3e-3, (0.10, 0.10, 0.10), (0.80, 0.80, 0.80))  # the squares, not the grain
RED_BALL = Material(MOTTLED, 0.35e-3, (0.02, 0.02, 0.20), (0.11, 0.13, 0.80))
ORANGE_BALL = Material(MOTTLED, 0.35e-3, (0.02, 0.05, 0.20), (0.10, 0.28, 0.80))
YELLOW_BALL = Material(MOTTLED, 0.35e-3, (0.02, 0.17, 0.20), (0.10, 0.66, 0.78))
GREEN_BALL = Material(MOTTLED, 0.35e-3, (0.03, 0.18, 0.03), (0.15, 0.70, 0.13))
STONE = Material(MOTTLED, 0.5e-3, (0.10, 0.11, 0.12), (0.46, 0.48, 0.50))
HULL = Material(GRAINED, 1e-3, (0.03, 0.30, 0.34), (0.05, 0.46, 0.52))  # yellow
ORANGE_FISH = Material(BLOTCHED, 0.3e-3, (0.02, 0.09, 0.42), (0.62, 0.74, 0.80))  # a koi: orange and cream
SILVER_FISH = Material(BLOTCHED, 0.3e-3, (0.14, 0.13, 0.11), (0.66, 0.64, 0.60))
BROWN_FISH = Material(BLOTCHED, 0.3e-3, (0.03, 0.06, 0.08), (0.22, 0.36, 0.44))
FISH = (ORANGE_FISH, SILVER_FISH, BROWN_FISH)
MATERIALS = (WALL, FLOOR, SURFACE, CHESSBOARD, RED_BALL, YELLOW_BALL, GREEN_BALL, STONE, HULL, ORANGE_BALL, *FISH)


@lru_cache(maxsize=2)  # all cameras of a tank see the same surfaces
def atlas(seed: int, blotched: bool = False) -> NDArray[np.uint8]:
    """(layers, texels): for each layer its mip levels one after the other, each row by row; 255 is all light.

    blotched: with that layer, which takes its time to make.
    """
    tiled = 0.5 + 0.10 * _noise(generator(seed, "tiled"), slope=0.9)
    texel = np.arange(SIZE)
    joint = (texel % (SIZE // 8)) < 4
    tiled[joint, :] *= 0.55
    tiled[:, joint] *= 0.55
    mottled = 0.5 + 0.16 * _noise(generator(seed, "mottled"), slope=1.0) + 0.12 * _grain(generator(seed, "grain"))
    grained = 0.5 + 0.25 * _grain(generator(seed, "board"))
    layers = [tiled, mottled, grained]
    if blotched:
        blotches = np.tanh(2.0 * _noise(generator(seed, "blotches"), slope=2.0))
        layers.append(0.5 + 0.30 * blotches + 0.10 * _grain(generator(seed, "scales")))
    return np.stack([_mips(layer) for layer in layers])


def _noise(rng: np.random.Generator, slope: float) -> NDArray[np.float64]:
    """Periodic noise whose amplitude falls as 1 / frequency^slope; zero mean, unit deviation."""
    spectrum = np.fft.rfft2(rng.standard_normal((SIZE, SIZE)))
    f = np.hypot(np.fft.fftfreq(SIZE)[:, None], np.fft.rfftfreq(SIZE)[None, :]) * SIZE
    f[0, 0] = np.inf
    spectrum *= np.maximum(f, 8.0) ** -slope  # flat below 8 waves: no surface is dark on one side
    noise = np.fft.irfft2(spectrum, (SIZE, SIZE))
    return np.asarray(noise / noise.std())


def _grain(rng: np.random.Generator) -> NDArray[np.float64]:
    """Independent texels, softened so that one pixel never hits a single texel."""
    white = rng.standard_normal((SIZE, SIZE))
    soft = white + np.roll(white, 1, 0)
    soft = soft + np.roll(soft, 1, 1)
    return soft / 2


def _mips(texture: NDArray[np.float64]) -> NDArray[np.uint8]:
    level, levels = np.clip(texture, 0, 1), []
    for _ in range(LEVELS):
        levels.append(np.round(level * 255).astype(np.uint8).ravel())
        level = level.reshape(level.shape[0] // 2, 2, -1, 2).mean((1, 3))
    return np.concatenate(levels)


# --- view: poses and sizes, seen from one camera, become the maps that `trace` works with ---

Affine = NDArray[np.float64]  # (3, 4) rotation and shift

HULL_RADII_M = (0.14, 0.14, 0.08)
FACES = [MATERIALS.index(m) for m in (*[WALL] * 4, FLOOR, SURFACE, CHESSBOARD)]
STONE_MATERIAL, HULL_MATERIAL = (MATERIALS.index(m) for m in (STONE, HULL))
BALLS = {
    "red": MATERIALS.index(RED_BALL),
    "orange": MATERIALS.index(ORANGE_BALL),
    "yellow": MATERIALS.index(YELLOW_BALL),
    "green": MATERIALS.index(GREEN_BALL),
}
FISH_MATERIALS = {
    "orange": MATERIALS.index(ORANGE_FISH),
    "silver": MATERIALS.index(SILVER_FISH),
    "brown": MATERIALS.index(BROWN_FISH),
}

EVERYWHERE, NOWHERE = (-100_000, -100_000, 100_000, 100_000), (0, 0, 0, 0)
STRAIGHT = 1.3  # rad off the axis; what lies beyond is never in the picture
BEND, SLACK_PX = 1.15, 12  # refraction draws outer parts further out; generous, for bounds only save time


class Eye(NamedTuple):
    """Optical centre of a camera; `rotation` (3, 3) turns camera axes (right, down, forward) into the world's."""

    position_m: ArrayLike
    rotation: ArrayLike


class Hull(NamedTuple):
    """Another robot's body, an ellipsoid; `rotation` (3, 3) body to world."""

    position_m: ArrayLike
    rotation: ArrayLike


class Chessboard(NamedTuple):
    """A calibration board: its plane is x-y, its z points to the viewer; `rotation` (3, 3) board to world."""

    position_m: ArrayLike
    rotation: ArrayLike
    size_m: tuple[float, float] = (0.30, 0.20)


class Ellipsoid(NamedTuple):
    position_m: ArrayLike
    rotation: ArrayLike
    radii_m: tuple[float, float, float]
    material: int
    pattern_m: tuple[float, float] = (0.0, 0.0)  # where on its texture its middle is
    cube: bool = False  # a box of these half lengths


class Swimming(NamedTuple):
    """A creature as it is bent at one instant."""

    name: str
    parts: tuple[Ellipsoid, ...]


class LampBeam(NamedTuple):
    """One lamp that burns; world frame."""

    position_m: ArrayLike  # (3,)
    aim: ArrayLike  # (3,) unit vector
    power: float  # of full power, 0 to 1


class Moment(NamedTuple):
    """What is around a camera at one instant, its own robot left out."""

    eye: Eye
    solids: Sequence[Solid] = ()
    hulls: Sequence[Hull] = ()
    tags: Sequence[PaintedTag] = ()
    chessboard: Chessboard | None = None
    creatures: Sequence[Swimming] = ()
    lamps: Sequence[LampBeam] = ()  # that burn, its own robot's too
    own_hull: Hull | None = None  # which throws shadows; not needed where no lamp burns


def make_view(moment: Moment, image_distance_m: float, lens: Lens, index: float, box_m: ArrayLike) -> View:
    """The world (metres, world frame; `box_m` (3,) is the water body) in the camera's own terms, but for its tags.

    The picture's scale follows the image distance: that is focus breathing.
    """
    eye, chessboard = moment.eye, moment.chessboard
    slope = lens.pixel_m / image_distance_m
    camera = affine(eye.rotation, eye.position_m)
    bodies = [
        Ellipsoid(
            s.position_m,
            turned(s.turn_deg),
            s.radii_m,
            BALLS[s.colour] if s.kind == "ball" else STONE_MATERIAL,
            cube=s.kind == "box",
        )
        for s in moment.solids
    ]
    bodies += [Ellipsoid(h.position_m, h.rotation, HULL_RADII_M, HULL_MATERIAL) for h in moment.hulls]
    bodies += [part for creature in moment.creatures for part in creature.parts]
    to_unit = [relative(b.rotation, b.position_m, camera) / np.array(b.radii_m)[:, None] for b in bodies]
    optics = (slope, *lens.centre_px, lens.k1, lens.k2, index**2, lens.port_gap_m)
    return View(
        optics=Optics(*_float32(optics)),
        camera=_rows(camera),
        box=_float32(np.asarray(box_m)),
        chessboard=_rows(relative(chessboard.rotation, chessboard.position_m, camera) if chessboard else camera),
        chessboard_half=_float32((chessboard.size_m[0] / 2, chessboard.size_m[1] / 2) if chessboard else (0.0, 0.0)),
        solids=np.array(to_unit, np.float32).reshape(-1, 3, 4),
        bounds=np.array([pixel_bounds(b, camera, lens, index / slope) for b in bodies], np.int64).reshape(-1, 4),
        radii=np.array([b.radii_m for b in bodies], np.float32).reshape(-1, 3),
        up=np.array([np.asarray(b.rotation)[2] for b in bodies], np.float32).reshape(-1, 3),
        cubes=np.array([b.cube for b in bodies], np.int64),
        pattern=np.array([b.pattern_m for b in bodies], np.float32).reshape(-1, 2),
        material=np.array(FACES + [b.material for b in bodies]),
    )


def pixel_bounds(body: Ellipsoid, camera: Affine, lens: Lens, focal_px: float) -> tuple[int, int, int, int]:
    """Pixels x0, y0, x1, y1 that the sphere around an ellipsoid can cover; all of them when the camera is close."""
    radius_m = float(np.hypot(np.hypot(*body.radii_m[:2]), body.radii_m[2])) if body.cube else max(body.radii_m)
    x, y, z = camera[:, :3].T @ (np.asarray(body.position_m) - camera[:, 3])
    low, high = [], []
    for across, centre_px in zip((x, y), lens.centre_px, strict=True):
        distance = np.hypot(across, z)
        if distance <= radius_m * 1.01:
            return EVERYWHERE
        towards, half = np.arctan2(across, z), np.arcsin(radius_m / distance)
        if abs(towards) - half >= STRAIGHT:
            return NOWHERE
        edges = np.tan(np.clip([towards - half, towards + half], -STRAIGHT, STRAIGHT)) * focal_px
        low.append(int(min(edges[0], edges[0] * BEND) + centre_px) - SLACK_PX)
        high.append(int(max(edges[1], edges[1] * BEND) + centre_px) + SLACK_PX)
    return low[0], low[1], high[0], high[1]


def turned(turn_deg: tuple[float, float, float]) -> Affine:
    """(3, 3) body to world, by yaw, pitch and roll: Rz Ry Rx."""
    (cy, cp, cr), (sy, sp, sr) = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    yaw = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    pitch = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    roll = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    return np.asarray(yaw @ pitch @ roll)


def affine(rotation: ArrayLike, position_m: ArrayLike) -> Affine:
    return np.column_stack([np.asarray(rotation, float), np.asarray(position_m, float)])


def relative(rotation: ArrayLike, position_m: ArrayLike, camera: Affine) -> Affine:
    """Camera to body, from body to world (`rotation`, `position_m`) and camera to world."""
    to_body = np.asarray(rotation, float).T
    return np.column_stack([to_body @ camera[:, :3], to_body @ (camera[:, 3] - np.asarray(position_m, float))])


def _float32(numbers: Iterable[float]) -> Any:
    return tuple(np.float32(number) for number in numbers)


def _rows(affine: Affine) -> Map:
    x, y, z = affine
    return _float32(x), _float32(y), _float32(z)
