"""What one robot's camera sees: the order of work from a pose to the bytes of a frame.

trace (which surface, how far) -> shade (light, water) -> blur (lens) -> expose (noise, gamma).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.config import Tank
from hw.twin import texture
from hw.twin.defocus import apparent_m, blur, circle_gain, margin, vergence
from hw.twin.exposure import expose, gamma_curve, noise_key, normal_quantiles
from hw.twin.lens import Lens
from hw.twin.raycast import Floats, Map, Optics, View, trace
from hw.twin.scene import Scene, generator
from hw.twin.shade import PER_M, Looks, shade
from hw.twin.texture import MATERIALS
from hw.twin.water import daylight, draw_water, look_through

Image = NDArray[np.uint8]  # (h, w, 3), blue green red
Affine = NDArray[np.float64]  # (3, 4) rotation and shift
Part = tuple[int, int, int, int]  # x, y, width, height in the full frame

WALL, FLOOR, SURFACE, BOARD, HULL = (
    MATERIALS.index(m) for m in (texture.WALL, texture.FLOOR, texture.SURFACE, texture.BOARD, texture.HULL)
)
SOLID_MATERIAL = {"ball": MATERIALS.index(texture.BALL), "stone": MATERIALS.index(texture.STONE)}
HULL_RADII_M = (0.14, 0.14, 0.08)
WHITE_M, WHITE_LEVEL = 0.5, 0.75  # the exposure is set once: a white upright card at this range has this level
WHITE_ALBEDO, UPRIGHT = 0.8, 0.6
LARGEST_PX = 14.0  # radius of blur; what is blurrier is drawn with this one
EVERYWHERE, NOWHERE = (-100_000, -100_000, 100_000, 100_000), (0, 0, 0, 0)
STRAIGHT = 1.3  # rad off the axis; nothing beyond is ever in the picture
BEND, SLACK_PX = 1.15, 12  # generous: bounds only save time
ALIGN = 4  # the coarsest pixel of the blur lies on the same grid whichever part is asked for


class Eye(NamedTuple):
    """Optical centre of a camera; `rotation` (3, 3) turns camera axes (right, down, forward) into the world's."""

    position_m: ArrayLike
    rotation: ArrayLike


class Hull(NamedTuple):
    """Another robot's body, an ellipsoid; `rotation` (3, 3) body to world."""

    position_m: ArrayLike
    rotation: ArrayLike


class Board(NamedTuple):
    """A calibration board: its plane is x-y, its z points to the viewer; `rotation` (3, 3) board to world."""

    position_m: ArrayLike
    rotation: ArrayLike
    size_m: tuple[float, float] = (0.30, 0.20)


class Painter:
    """One robot's view of a scene. Lens and water are hidden draws; one thread uses a painter at a time."""

    def __init__(self, scene: Scene, tank: Tank, refractive_index: float, lens: Lens, seed: int, robot: str) -> None:
        self._scene = scene
        self._box = np.array([tank.size_m[0], tank.size_m[1], tank.surface_m])
        self._index = refractive_index
        self._lens = lens
        self._seed, self._robot = seed, robot
        self._looks: Looks | None = None
        self._gain = np.float32(1)

    def prepare(self) -> None:
        """Make textures and tables, set the exposure, and let the kernels compile: seconds on a fresh machine."""
        water = draw_water(self._scene.water, generator(self._seed, "water"))
        room = self._scene.room_light
        steps = np.arange(int(np.linalg.norm(self._box) * PER_M) + 2) / PER_M
        through, veil = look_through(water, steps)
        day = room * daylight(water, steps)
        self._looks = Looks(
            atlas=texture.atlas(self._seed),
            layer=np.array([m.layer for m in MATERIALS]),
            texels_per_m=np.array([1 / m.texel_m for m in MATERIALS], np.float32),
            dark=np.array([m.dark for m in MATERIALS], np.float32),
            light=np.array([m.light for m in MATERIALS], np.float32),
            path=np.concatenate([through, room * veil], axis=1).astype(np.float32),
            day=day.astype(np.float32),
        )
        card = WHITE_ALBEDO * UPRIGHT * room * daylight(water, self._box[2]) * look_through(water, WHITE_M)[0]
        self._gain = np.float32(WHITE_LEVEL / card.max())
        middle = Eye(self._box / 2, np.eye(3))
        self.frame(middle, self._lens.at_rest_m, board=Board((0, 0, -1), np.eye(3)), roi=(0, 0, 64, 64))

    def frame(
        self,
        eye: Eye,
        image_distance_m: float,
        hulls: tuple[Hull, ...] = (),
        board: Board | None = None,
        roi: Part | None = None,
        tick: int = 0,
    ) -> Image:
        """The picture (h, w, 3) of the frame numbered `tick`, or its part `roi`; the rest is then not computed."""
        if self._looks is None:
            raise RuntimeError("call prepare() before the first frame")
        part = roi or (0, 0, self._lens.width, self._lens.height)
        view = self._view(eye, image_distance_m, hulls, board)
        x0, y0, depth, identity = _trace(view, _grown(part, margin(LARGEST_PX)))
        radius = self._circles(depth, image_distance_m)
        x, y, width, height = part
        largest = radius[y - y0 : y - y0 + height, x - x0 : x - x0 + width].max()
        left, top, inner_width, inner_height = _grown(part, margin(float(largest)))
        inner = np.s_[top - y0 : top - y0 + inner_height, left - x0 : left - x0 + inner_width]
        picture = np.empty((inner_height, inner_width, 3), np.float32)
        shade(
            view,
            self._looks,
            left,
            top,
            np.ascontiguousarray(depth[inner]),
            np.ascontiguousarray(identity[inner]),
            picture,
        )
        picture = blur(picture, np.ascontiguousarray(radius[inner]))
        image = np.empty((height, width, 3), np.uint8)
        expose(
            picture,
            self._gain,
            noise_key(self._seed, self._robot, tick),
            x,
            y,
            x - left,
            y - top,
            self._lens.width,
            normal_quantiles(),
            gamma_curve(),
            image,
        )
        return image

    def depth(
        self,
        eye: Eye,
        image_distance_m: float,
        hulls: tuple[Hull, ...] = (),
        board: Board | None = None,
        roi: Part | None = None,
    ) -> Floats:
        """Truth (h, w): z-depth in metres from the optical centre, along the refracted ray that is rendered."""
        part = roi or (0, 0, self._lens.width, self._lens.height)
        return _trace(self._view(eye, image_distance_m, hulls, board), part)[2]

    def _circles(self, depth: Floats, image_distance_m: float) -> Floats:
        """Radius of the circle of confusion of each pixel, px."""
        gain = np.float32(circle_gain(self._lens, image_distance_m))
        seen = apparent_m(depth, self._index, self._lens.port_gap_m)
        error = np.float32(vergence(self._lens, image_distance_m)) - np.float32(1) / seen
        return np.minimum(gain * np.abs(error), np.float32(LARGEST_PX))

    def _view(self, eye: Eye, image_distance_m: float, hulls: tuple[Hull, ...], board: Board | None) -> View:
        lens = self._lens
        slope = lens.pixel_m / image_distance_m
        camera = _affine(eye.rotation, eye.position_m)
        bodies = [(s.position_m, np.eye(3), s.radii_m, SOLID_MATERIAL[s.kind]) for s in self._scene.solid]
        bodies += [(h.position_m, np.asarray(h.rotation), HULL_RADII_M, HULL) for h in hulls]
        solids = np.empty((len(bodies), 3, 4))
        for to_unit, (centre, rotation, radii, _) in zip(solids, bodies, strict=True):
            to_unit[:] = _inverse(rotation, centre, camera) / np.array(radii)[:, None]
        return View(
            optics=Optics(
                *_float32((slope, *lens.centre_px, lens.k1, lens.k2, self._index**2, lens.port_gap_m)),
            ),
            camera=_rows(camera),
            box=_float32(self._box),
            board=_rows(_inverse(board.rotation, board.position_m, camera) if board else camera),
            board_half=_float32((board.size_m[0] / 2, board.size_m[1] / 2) if board else (0, 0)),
            solids=solids.astype(np.float32),
            bounds=np.array([self._bounds(b[0], max(b[2]), camera, slope) for b in bodies], np.int64).reshape(-1, 4),
            radii=np.array([b[2] for b in bodies], np.float32).reshape(-1, 3),
            up=np.array([np.asarray(b[1])[2] for b in bodies], np.float32).reshape(-1, 3),
            material=np.array([WALL] * 4 + [FLOOR, SURFACE, BOARD] + [b[3] for b in bodies]),
        )

    def _bounds(self, centre_m: ArrayLike, radius_m: float, camera: Affine, slope: float) -> tuple[int, int, int, int]:
        """Pixels that a sphere around an ellipsoid can cover; all of them when the camera is close to it."""
        x, y, z = camera[:, :3].T @ (np.asarray(centre_m) - camera[:, 3])
        low, high = [], []
        for across, centre_px in zip((x, y), self._lens.centre_px, strict=True):
            distance = np.hypot(across, z)
            if distance <= radius_m * 1.01:
                return EVERYWHERE
            towards, half = np.arctan2(across, z), np.arcsin(radius_m / distance)
            if abs(towards) - half >= STRAIGHT:
                return NOWHERE
            edges = np.tan(np.clip([towards - half, towards + half], -STRAIGHT, STRAIGHT)) * self._index / slope
            wide = edges * BEND  # refraction and distortion draw the outer parts further out
            low.append(int(np.floor(min(edges[0], wide[0]) + centre_px)) - SLACK_PX)
            high.append(int(np.ceil(max(edges[1], wide[1]) + centre_px)) + SLACK_PX)
        return low[0], low[1], high[0], high[1]


def _trace(view: View, part: Part) -> tuple[int, int, Floats, NDArray[np.uint8]]:
    x, y, width, height = part
    depth = np.empty((height, width), np.float32)
    identity = np.empty((height, width), np.uint8)
    trace(view, x, y, depth, identity)
    return x, y, depth, identity


def _grown(part: Part, rim: int) -> Part:
    """A part and `rim` pixels around it, on the grid of the coarsest pixels."""
    x, y, width, height = part
    x0, y0 = (x - rim) // ALIGN * ALIGN, (y - rim) // ALIGN * ALIGN
    return x0, y0, -(-(x + width + rim - x0) // ALIGN) * ALIGN, -(-(y + height + rim - y0) // ALIGN) * ALIGN


def _affine(rotation: ArrayLike, position_m: ArrayLike) -> Affine:
    return np.column_stack([np.asarray(rotation, float), np.asarray(position_m, float)])


def _inverse(rotation: ArrayLike, position_m: ArrayLike, camera: Affine) -> Affine:
    """Camera to body, from body to world and camera to world."""
    turn = np.asarray(rotation, float).T
    return np.column_stack([turn @ camera[:, :3], turn @ (camera[:, 3] - np.asarray(position_m, float))])


def _float32(numbers: Iterable[float]) -> tuple[np.float32, ...]:
    return tuple(np.float32(number) for number in numbers)


def _rows(affine: Affine) -> Map:
    return tuple(_float32(row) for row in affine)
