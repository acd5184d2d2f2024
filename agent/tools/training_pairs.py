"""Pairs of pictures for training: of our own making, written once to a folder and read from there picture by picture;
renders of the twin; augmented real pairs; and what may be asked of a training.

Of six pairs three are landscapes of noise, two photographs, and one is a view of the twin's tank: tanks look alike.
Most landscapes and photographs have vivid things in them, and some have no water.
Pair `i` of a seed is always the same, so several processes can share the work. A scene is a landscape, a photograph
or a tank; validation has scenes of its own, of which training sees nothing.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.core.config import ConfigError, Tank
from agent.process.command import Progress, new_file
from agent.tools.enhance import paired, read_pair
from agent.tools.training_scenes import (
    FAR,
    GAMMA,
    HELD_OUT,
    MOST,
    TEXTURES,
    Image,
    Picture,
    coded_bytes,
    draw_sea,
    draw_thing,
    finish,
    landscape,
    noise,
    pair,
    photograph,
    photograph_files,
    photograph_scene,
    put_into,
    submerge,
    with_things,
)
from hw.camera.files import read_picture
from hw.twin.optics.lens import Lens, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Chessboard, Eye, Hull
from hw.twin.scene import SceneWater, Solid, load_scene

# --- augmentation ---
# What a hundred real pairs are made of to stand for all water: their own, other water, and hardly any.
#
# A pair is used in one of three ways. As it is, with another white balance, exposure and contrast of the camera. Its
# reference in drawn water (training_scenes.py), for blue, green and turbid seas that no pair shows. Its reference as
# good as it is, so that the network learns to leave a good picture alone. In front of most of them are vivid things
# (training_scenes.py), seen through the same water. In place of some of them stands a pair of our own making, lest
# what was learned of other water and of vivid things be forgotten over the dull ones.
#
# The pair's own water, for things that are put into it, is fitted: raw = gain * reference + veil per colour, in
# linear light. A thing that is nearer than the scene has lost less colour and has less veil in front of it.
#
# Pictures are (side, side, 3) uint8 coded, blue green red, unless said otherwise.

OWN = 0.25  # share of pairs of our own making
OTHER_WATER, AUGMENT_NO_WATER = 0.3, 0.15  # shares of the others; the rest are as they are
WITH_THINGS = 0.7
TINT, EXPOSURE, CONTRAST = 0.12, 0.25, 0.15  # deviations of the logarithms of gain per colour, of light, of gamma
SLIGHT = 0.3  # of these for a picture without water
GAINS = (0.01, 4.0)  # that a fit may give: beyond is no water


class Water(NamedTuple):
    """raw = gain * reference + veil, (3,) each, linear light blue green red."""

    gain: Picture
    veil: Picture


def augmented(raw: Image, reference: Image, rng: np.random.Generator) -> tuple[Image, Image]:
    """A pair that a real one stands for."""
    if rng.random() < OWN:
        picture, z, vivid = with_things(*landscape(raw.shape[0], rng), rng)
        return pair(picture, z, rng, vivid)
    count = int(rng.integers(1, MOST + 1)) if rng.random() < WITH_THINGS else 0
    things = [draw_thing(raw.shape[0], rng) for _ in range(count)]
    clear, way = linear(reference), rng.random()
    seen, water = linear(raw), water_of(raw, reference)
    for thing in things:
        clear = put_into(clear, thing)
        near = through(thing.picture, water, float(rng.random()))
        seen = put_into(seen, thing._replace(picture=near))
    target = coded_bytes(clear) if things else reference
    if way < OTHER_WATER:
        return in_other_water(clear, rng), target
    if way < OTHER_WATER + AUGMENT_NO_WATER:
        return as_taken(clear, SLIGHT, rng), target
    return as_taken(seen, 1.0, rng), target


def water_of(raw: Image, reference: Image) -> Water:
    """Least squares per colour; a colour that does not follow its reference keeps its mean."""
    x, y = linear(reference).reshape(-1, 3), linear(raw).reshape(-1, 3)
    mx, my = x.mean(0), y.mean(0)
    slope = ((x - mx) * (y - my)).mean(0) / np.maximum(((x - mx) ** 2).mean(0), 1e-6)
    gain = np.clip(slope, *GAINS)
    return Water(np.asarray(gain, np.float32), np.asarray(np.maximum(my - gain * mx, 0), np.float32))


def through(picture: Picture, water: Water, share: float) -> Picture:
    """Linear light through a share of the water's path: exposure stays, colour is lost and veil gained."""
    exposure = water.gain.max()
    lost = (water.gain / exposure) ** np.float32(share)
    return np.asarray(exposure * lost * picture + np.float32(share) * water.veil, np.float32)


def in_other_water(clear: Picture, rng: np.random.Generator) -> Image:
    """A picture without water, linear, put into some and photographed; its ranges are invented."""
    side, sea = clear.shape[0], draw_sea(rng)
    slope = np.float32(rng.uniform(0, 1.5)) * np.linspace(1, -0.5, side, dtype=np.float32)[:, None]
    z = np.exp(slope + np.float32(rng.uniform(0, 0.3)) * noise(side, rng, (8, 12)))
    z = np.clip(z / np.median(z), 0.1, FAR) * np.float32(sea.green_depth / sea.direct[1])
    return photograph(submerge(clear, np.asarray(z, np.float32), sea, float(rng.uniform(0.3, 1.0))), rng)


def as_taken(picture: Picture, strength: float, rng: np.random.Generator) -> Image:
    """Linear light as another camera would have taken it: gain per colour, exposure, contrast."""
    gain = np.exp(rng.normal(0, strength * TINT, 3) + rng.normal(-0.1, strength * EXPOSURE)).astype(np.float32)
    bend = np.float32(np.exp(rng.normal(0, strength * CONTRAST)))
    return coded_bytes(np.clip(picture * gain, 0, 1) ** bend)


def linear(image: Image) -> Picture:
    """Coded uint8 -> linear light, 0 to 1."""
    return np.asarray(cv2.LUT(image, _LINEAR), np.float32)


_LINEAR = ((np.arange(256) / 255) ** GAMMA).astype(np.float32)

# --- renders of the twin ---
# Views of the tank twin with the water on and off: same eye, same surfaces, exact ranges.
#
# The twin's tank is a metre across and its default water is clear, so half of the views keep the twin's own water,
# dirty, and the other half are rendered in air, given other colours, and put into water from anywhere by their true
# ranges.

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


# --- the data set ---

VIEWS_PER_TANK = 40  # a tank takes a second to fill
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
    return read_picture(file, upright=True)


# --- pairs by scene ---
# Pairs of pictures from two folders, and which of them show the same scene.

HASH_SIDE = 16  # 256 bits
SAME_BITS = 75  # of 256: frames of one clip; unrelated pictures differ in about 128
THUMBNAIL, SAME_COLOUR = 8, 7.0  # px a side; rms CIELAB difference below which two views are of one place


def read_pairs(raw: Path, reference: Path, side: int, show: Progress = lambda done, total: None) -> Pairs:
    """All pairs, scaled to side x side. Raises ConfigError: no pairs, a broken picture, sizes that differ."""
    files, _ = paired(raw, reference)
    images: tuple[list[Image], list[Image]] = ([], [])
    for done, (ours, theirs) in enumerate(files, 1):
        for kept, image in zip(images, read_pair(ours, theirs, (side, side)), strict=True):
            kept.append(image)
        show(done, len(files))
    stacks = np.stack(images[0]), np.stack(images[1])
    return Pairs(*stacks, np.array([f"scene-{number}" for number in scenes(stacks[0])]))


def scenes(images: NDArray[np.uint8]) -> list[int]:
    """Number of the scene that each of (n, h, w, 3) pictures shows: those alike in outline or in colours are one.

    Likeness is passed on: a clip's first and last frame share a scene if those between link them. Errs towards too
    few scenes, for what is split over training and validation makes the figures too good.
    """
    hashes = np.array([outline(image) for image in images])
    small = np.array([cv2.resize(image, (THUMBNAIL, THUMBNAIL), interpolation=cv2.INTER_AREA) for image in images])
    lab = np.array([cv2.cvtColor(s.astype(np.float32) / 255, cv2.COLOR_BGR2LAB) for s in small])
    number = list(range(len(images)))
    for i in range(len(images)):
        bits = (hashes[:i] != hashes[i]).sum(1)
        apart = np.sqrt(((lab[:i] - lab[i]) ** 2).mean((1, 2, 3)))
        for j in np.flatnonzero((bits <= SAME_BITS) | (apart <= SAME_COLOUR)):
            old, new = max(number[i], number[j]), min(number[i], number[j])
            number = [new if n == old else n for n in number]
    return number


def outline(image: Image) -> NDArray[np.bool_]:
    """(256,) is each of 16x16 patches brighter than its right-hand neighbour: blind to colour and contrast."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    patches = cv2.resize(grey, (HASH_SIDE + 1, HASH_SIDE), interpolation=cv2.INTER_AREA)
    return np.asarray(patches[:, :-1] > patches[:, 1:]).ravel()


def folds(scene: NDArray[np.str_], count: int, seed: int) -> NDArray[np.intp]:
    """(n,) fold of each pair: scenes stay whole, folds are about equally large.

    Raises ConfigError if there are fewer scenes than folds.
    """
    names, sizes = np.unique(scene, return_counts=True)
    if len(names) < count:
        raise ConfigError(f"{len(names)} scenes cannot make {count} folds; give pairs of more scenes, or fewer folds")
    order = np.random.default_rng(seed).permutation(len(names))
    filled, place = [0] * count, {}
    for i in sorted(order, key=lambda k: -int(sizes[k])):  # the largest first, into the emptiest
        fold = filled.index(min(filled))
        place[names[i]] = fold
        filled[fold] += int(sizes[i])
    return np.array([place[name] for name in scene])


# --- what is asked of a training ---
# As far as it can be judged without torch, whose import takes seconds.

ENDS_IN = ".safetensors"


def check(
    pairs: tuple[Path, Path] | None, start: Path | None, out: Path | None, resume: bool, cross_validate: int | None
) -> None:
    """Raises ConfigError for options that do not go together, for files and folders that are not there, and for those
    that are there and would be overwritten."""
    if resume and out is None:
        raise ConfigError("--resume needs --out, the weights whose checkpoint lies beside it")
    if cross_validate is not None and (pairs is None or start is None):
        raise ConfigError("--cross-validate needs --pairs RAW REFERENCE and --start WEIGHTS")
    if start is not None and not start.is_file():
        raise ConfigError(f"{start}: no such file; give weights that `aucamp train` wrote, hash beside")
    if out is not None and cross_validate is None:
        if out.suffix != ENDS_IN:
            raise ConfigError(f"{out}: give --out a name that ends in {ENDS_IN}")
        _check_resumed(out) if resume else _check_new(out)
    if pairs is not None:
        paired(*pairs)


def _check_new(out: Path) -> None:
    if checkpoint_of(out).exists() and not out.exists():
        raise ConfigError(
            f"{checkpoint_of(out)}: is there already, of a training that was cut off; go on with --resume, "
            "or give --out another name"
        )
    for file in (out, *(out.with_suffix(end) for end in (".checkpoint", ".csv", ".png"))):
        new_file(file)


def _check_resumed(out: Path) -> None:
    if not checkpoint_of(out).is_file():
        raise ConfigError(f"{checkpoint_of(out)}: no such checkpoint; start anew without --resume")
    if out.with_name(out.name + ".sha256").exists():  # the last file that a training writes
        raise ConfigError(f"{out}: this training has ended; train on with --start {out} and another --out")


def checkpoint_of(weights: Path) -> Path:
    """Where a run that is to write `weights` keeps what it needs to go on."""
    return weights.with_suffix(".checkpoint")
