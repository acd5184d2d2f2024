"""Photographs that anybody may use, as scenes to put water in: their ranges are invented.

They come with scikit-image and matplotlib, so nothing is fetched: astronaut, rocket and grace_hopper are in the public
domain (NASA, US Navy), coffee, chelsea, brick, gravel and grass are CC0 (the packages' README files say so).
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

from agent.core.config import ConfigError
from agent.tools.degrade import GAMMA, Image, Picture, Plane
from agent.tools.landscapes import FAR, colour, noise

COLOURED = ("astronaut.png", "coffee.png", "chelsea.png", "rocket.jpg", "grace_hopper.jpg")
TEXTURES = ("brick.png", "gravel.png", "grass.png")  # grey: they are given two colours
HELD_OUT = ("chelsea.png", "gravel.png")  # for validation


def photograph_files() -> list[Path]:
    """All of them. Raises ConfigError if scikit-image is not installed."""
    folders = [Path(spec.origin).parent for spec in map(find_spec, ("skimage", "matplotlib")) if spec and spec.origin]
    places = [folder / "data" for folder in folders] + [folder / "mpl-data" / "sample_data" for folder in folders]
    found = [place / name for name in COLOURED + TEXTURES for place in places if (place / name).is_file()]
    if len(found) < len(COLOURED + TEXTURES):
        raise ConfigError("the training photographs come with scikit-image: in your clone: pip install -e '.[train]'")
    return found


def photograph_scene(image: Image, grey: bool, side: int, rng: np.random.Generator) -> tuple[Picture, Plane]:
    """A part of a photograph (coded) -> (side, side, 3) linear light and (side, side) range, median 1."""
    share = min(image.shape[:2]) * rng.uniform(0.4, 1.0)
    size = max(int(share), 2)
    y, x = (int(rng.integers(0, length - size + 1)) for length in image.shape[:2])
    part = cv2.resize(image[y : y + size, x : x + size], (side, side), interpolation=cv2.INTER_AREA)
    part = np.rot90(part, int(rng.integers(0, 4)))[:, :: int(rng.choice((-1, 1)))]
    linear = (part.astype(np.float32) / np.float32(255)) ** np.float32(GAMMA)
    if grey:
        dark, light = colour(rng, 0.1) * np.float32(0.2), colour(rng, 0.1)
        linear = dark + linear * (light - dark)
    elif rng.random() < 0.3:
        linear = linear[:, :, rng.permutation(3)]
    slope = np.float32(rng.uniform(0, 1.5)) * np.linspace(1, -0.5, side, dtype=np.float32)[:, None]
    z = np.exp(slope + np.float32(rng.uniform(0, 0.2)) * noise(side, rng, (10, 12)))
    return np.ascontiguousarray(linear), np.clip(z / np.median(z), 0.1, FAR).astype(np.float32)
