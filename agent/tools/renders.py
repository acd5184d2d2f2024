"""Views of the tank twin with the water on and off: same eye, same surfaces, exact ranges.

The twin's tank is a metre across and its default water is clear, so half of the views keep the twin's own water, dirty,
and the other half are rendered in air, given other colours, and put into water from anywhere by their true ranges.
"""

from __future__ import annotations

from typing import Literal

import cv2
import numpy as np
from msgspec.structs import replace

from agent.core.config import Tank
from agent.tools.degrade import GAMMA, Image, Picture, finish, pair
from hw.twin.optics.lens import Lens, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.view import Chessboard, Eye, Hull
from hw.twin.scene import SceneWater, Solid, load_scene

INDEX = 1.333
PRESETS: tuple[Literal["tap", "pool", "coastal", "turbid"], ...] = ("tap", "pool", "coastal", "turbid")
MARGIN_M = 0.12  # between an eye and a wall


class Tankful:
    """One tank: surfaces, stones and lens of one seed, in dirty water and without any."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self._lens: Lens = draw_lens("binned_640", rng)
        self._tank = Tank()
        solids = tuple(_solid(rng, self._tank) for _ in range(int(rng.integers(1, 7))))
        dirt = SceneWater(preset=PRESETS[int(rng.integers(0, 4))], grey_per_m=float(rng.uniform(0.1, 1.5)))
        scene = replace(load_scene("tank"), solid=solids, water=dirt)
        clear = replace(scene, water=SceneWater(preset="air"))
        self._wet, self._dry = (Painter(s, self._tank, INDEX, self._lens, seed, "r1") for s in (scene, clear))
        self._wet.prepare()
        self._dry.prepare()

    def view(self, side: int, rng: np.random.Generator) -> tuple[Image, Image]:
        """(raw, target), both (side, side, 3) uint8, from a random place in the tank."""
        eye = _eye(rng, self._tank)
        sharp_m = self._lens.image_m(INDEX / float(rng.uniform(0.3, 1.2)))
        hulls = [Hull(_inside(rng, self._tank), np.eye(3))] if rng.random() < 0.4 else []
        board = Chessboard(_inside(rng, self._tank), _towards(rng.normal(size=3))) if rng.random() < 0.2 else None
        dry = _square(self._dry.frame(eye, sharp_m, hulls, board), side)
        clear = (dry.astype(np.float32) / np.float32(255)) ** np.float32(GAMMA)
        if rng.random() < 0.5:
            wet = self._wet.frame(eye, sharp_m, hulls, board, tick=int(rng.integers(0, 1000)))
            return _square(wet, side), finish(clear)
        z = _square(self._dry.depth(eye, sharp_m, hulls, board), side)
        return pair(_recoloured(clear, rng), z / np.median(z), rng)


def _solid(rng: np.random.Generator, tank: Tank) -> Solid:
    r = tuple(float(v) for v in rng.uniform(0.03, 0.12, 3))
    x, y = rng.uniform(0.2, 0.8, 2) * tank.size_m[:2]
    kind: Literal["ball", "stone"] = "ball" if rng.random() < 0.4 else "stone"
    return Solid(kind=kind, position_m=(float(x), float(y), r[2] * 0.9), radii_m=(r[0], r[1], r[2]))


def _inside(rng: np.random.Generator, tank: Tank) -> np.ndarray:
    room = np.array((tank.size_m[0], tank.size_m[1], tank.surface_m))
    return rng.uniform(MARGIN_M, room - MARGIN_M)


def _eye(rng: np.random.Generator, tank: Tank) -> Eye:
    """Somewhere, looking at somewhere on the floor's side of the middle."""
    place = _inside(rng, tank)
    goal = np.array((tank.size_m[0] / 2, tank.size_m[1] / 2, 0.1)) + rng.normal(0, 0.2, 3)
    return Eye(place, _towards(goal - place))


def _towards(forward: np.ndarray) -> np.ndarray:
    """(3, 3) camera axes right, down, forward as columns, the horizon level."""
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right = right / max(float(np.linalg.norm(right)), 1e-6)
    return np.column_stack([right, np.cross(forward, right), forward])


def _square(picture: np.ndarray, side: int) -> np.ndarray:
    height, width = picture.shape[:2]
    x = (width - height) // 2
    return cv2.resize(picture[:, x : x + height], (side, side), interpolation=cv2.INTER_AREA)


def _recoloured(picture: Picture, rng: np.random.Generator) -> Picture:
    """Colours mixed and scaled at random: a tank of other paints."""
    mix = np.eye(3) + rng.uniform(0, 0.6) * rng.normal(0, 0.5, (3, 3))
    mixed = picture @ mix.astype(np.float32).T * np.float32(rng.uniform(0.6, 1.5))
    return np.asarray(np.clip(mixed, 0.005, 1.5), np.float32)
