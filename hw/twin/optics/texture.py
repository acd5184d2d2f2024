"""Surfaces that a camera can focus on: periodic noise over all scales, with mip levels against aliasing."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.scene import generator

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
