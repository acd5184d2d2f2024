"""The training pairs of our own making, written once to a folder and read from there picture by picture.

Of six pairs three are landscapes of noise, two photographs, and one is a view of the twin's tank: tanks look alike.
Most landscapes and photographs have vivid things in them, and some have no water.
Pair `i` of a seed is always the same, so several processes can share the work. A scene is a landscape, a photograph
or a tank; validation has scenes of its own, of which training sees nothing.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.process.command import Progress
from agent.tools.augment import SLIGHT, as_taken, linear
from agent.tools.degrade import Image, pair
from agent.tools.landscapes import landscape
from agent.tools.photographs import HELD_OUT, TEXTURES, photograph_files, photograph_scene
from agent.tools.renders import Tankful
from agent.tools.things import with_things
from hw.picture_files import read_picture

VIEWS_PER_TANK = 40  # a tank takes a second to fill
WITH_THINGS = 0.7  # share of the landscapes and photographs that have vivid things in them
NO_WATER = 0.1  # share of them that are as good as they shall be already
HELD_OUT_SHARE = 20  # every twentieth landscape and tank is for validation


class Pairs(NamedTuple):
    """What the network is shown: (n, h, w, 3) uint8 blue green red, and the scene of each pair."""

    raw: NDArray[np.uint8]
    target: NDArray[np.uint8]
    scene: NDArray[np.str_]

    def only(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> Pairs:
        """Some of them, by mask or by number."""
        return Pairs(self.raw[chosen], self.target[chosen], self.scene[chosen])


def make_pairs(count: int, side: int, seed: int, show: Progress = lambda done, total: None) -> Pairs:
    """`count` pairs of side x side pixels. Raises ConfigError if the photographs are not installed."""
    raw, target = (np.empty((count, side, side, 3), np.uint8) for _ in range(2))
    scenes = []
    for i in range(count):
        raw[i], target[i], scene = make_pair(i, side, seed)
        scenes.append(scene)
        show(i + 1, count)
    return Pairs(raw, target, np.array(scenes))


def make_pair(i: int, side: int, seed: int) -> tuple[Image, Image, str]:
    """Pair `i` of a seed: raw, target, and the name of its scene."""
    rng = np.random.default_rng([seed, i])
    kind, turn = i % 6, i // 6
    if kind == 5:
        tank = turn // VIEWS_PER_TANK
        return *_tankful(seed * 1000 + tank).view(side, rng), f"tank-{tank}{_mark(tank)}"
    if kind >= 3:
        file = _files()[int(rng.integers(0, len(_files())))]
        scene = photograph_scene(_read(file), file.name in TEXTURES, side, rng)
        name = f"{file.stem}{'-held-out' if file.name in HELD_OUT else ''}"
    else:
        scene, name = landscape(side, rng), f"land-{i}{_mark(turn)}"
    vivid = None
    if rng.random() < WITH_THINGS:
        picture, z, vivid = with_things(*scene, rng)
        scene = picture, z
    raw, wanted = pair(*scene, rng, vivid)
    return as_taken(linear(wanted), SLIGHT, rng) if rng.random() < NO_WATER else raw, wanted, name


def split(pairs: Pairs) -> tuple[Pairs, Pairs]:
    """The pairs for training and those for validation."""
    held = np.char.endswith(pairs.scene, "-held-out")
    return pairs.only(~held), pairs.only(held)


def save(pairs: Pairs, file: Path) -> None:
    """Write pairs as NPZ."""
    with file.open("wb") as out:
        np.savez(out, **pairs._asdict())


def load(file: Path) -> Pairs:
    """Read what `save` wrote."""
    with np.load(file) as data:
        return Pairs(data["raw"], data["target"], data["scene"])


def _mark(number: int) -> str:
    return "-held-out" if number % HELD_OUT_SHARE == HELD_OUT_SHARE - 1 else ""


@lru_cache(maxsize=1)
def _tankful(seed: int) -> Tankful:
    return Tankful(seed)


@lru_cache(maxsize=1)
def _files() -> list[Path]:
    return photograph_files()


@lru_cache(maxsize=16)
def _read(file: Path) -> Image:
    return read_picture(file)
