"""Where everything is, seen from one camera: poses and sizes become the maps that the ray caster works with."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hw.twin.landmarks import PaintedTag
from hw.twin.optics import texture
from hw.twin.optics.lens import Lens
from hw.twin.optics.raycast import Map, Optics, View
from hw.twin.optics.texture import MATERIALS
from hw.twin.scene import Solid

Affine = NDArray[np.float64]  # (3, 4) rotation and shift

HULL_RADII_M = (0.14, 0.14, 0.08)
FACES = [MATERIALS.index(m) for m in (*[texture.WALL] * 4, texture.FLOOR, texture.SURFACE, texture.CHESSBOARD)]
STONE_MATERIAL, HULL_MATERIAL = (MATERIALS.index(m) for m in (texture.STONE, texture.HULL))
BALLS = {
    "red": MATERIALS.index(texture.RED_BALL),
    "orange": MATERIALS.index(texture.ORANGE_BALL),
    "yellow": MATERIALS.index(texture.YELLOW_BALL),
    "green": MATERIALS.index(texture.GREEN_BALL),
}
FISH_MATERIALS = {
    "orange": MATERIALS.index(texture.ORANGE_FISH),
    "silver": MATERIALS.index(texture.SILVER_FISH),
    "brown": MATERIALS.index(texture.BROWN_FISH),
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
    own_hull: Hull | None = None  # which throws shadows; where no lamp burns nobody asks


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
