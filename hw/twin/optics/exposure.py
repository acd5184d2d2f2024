"""Radiance to bytes: photon and read noise, a 12-bit converter, gamma, 8 bits.

The noise of a pixel is a function of (seed, robot, tick, pixel) alone: what else was read does not change it.
"""

from __future__ import annotations

import math
import zlib
from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.raycast import ONE, ZERO, F, Floats, kernel

FULL_WELL = 4000.0  # electrons; the shot noise of a pixel at full scale is its root
READ_NOISE = 0.004  # of full scale
ADC = 4095  # largest code
GAMMA = 2.2

INVERSE_WELL, READ_VARIANCE = np.float32(1 / FULL_WELL), np.float32(READ_NOISE**2)
FULL_SCALE, HALF = np.float32(ADC), np.float32(0.5)
# Steele, Lea and Flood 2014 (SplitMix64): one 64-bit hash a pixel, 12 bits a colour.
GOLDEN, MIX1, MIX2 = np.uint64(0x9E3779B97F4A7C15), np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
S24, S27, S30, S31, S40 = (np.uint64(bits) for bits in (24, 27, 30, 31, 40))
MASK12 = np.uint64(0xFFF)


@lru_cache(maxsize=1)
def normal_quantiles() -> Floats:
    """(4096,) the normal distribution in equal shares, unit deviation: a 12-bit number looks up its noise."""
    quantiles = np.array([NormalDist().inv_cdf((i + 0.5) / 4096) for i in range(4096)])
    return np.asarray(quantiles / quantiles.std(), np.float32)


@lru_cache(maxsize=1)
def gamma_curve() -> NDArray[np.uint8]:
    """(4096,) converter code to byte."""
    return np.round(255 * (np.arange(ADC + 1) / ADC) ** (1 / GAMMA)).astype(np.uint8)


def noise_key(seed: int, robot: str, tick: int) -> np.uint64:
    state = np.random.SeedSequence([seed, zlib.crc32(robot.encode()), tick]).generate_state(1, np.uint64)
    return np.uint64(state[0])


class Exposure(NamedTuple):
    """How one frame is taken."""

    scale: F  # share of full scale for a radiance of 1
    gain: F = ONE  # of the amplifier: the variance of all noise grows with it, in shares of full scale
    open_ns: int | None = None  # how long the shutter is open; None: as the camera does by itself


@kernel
def expose(
    picture: Floats,
    scale: F,
    gain: F,
    key: np.uint64,
    x0: int,
    y0: int,
    full_width: int,
    normal: Floats,
    curve: NDArray[np.uint8],
    image: NDArray[np.uint8],
) -> None:
    """Fill image (h, w, 3) from picture (h, w, 3); (x0, y0) is its place in the full frame.

    At gain g a converter is full at 1/g of the well, and read noise is READ_NOISE / sqrt(g) in electrons.
    """
    for row in range(image.shape[0]):
        for col in range(image.shape[1]):
            z = key + np.uint64((y0 + row) * full_width + x0 + col) * GOLDEN
            z = (z ^ (z >> S30)) * MIX1
            z = (z ^ (z >> S27)) * MIX2
            z ^= z >> S31
            for c in range(3):
                bits = (z if c == 0 else (z >> S24 if c == 1 else z >> S40)) & MASK12
                light = max(picture[row, col, c], ZERO) * scale
                light += math.sqrt((light * INVERSE_WELL + READ_VARIANCE) * gain) * normal[bits]
                image[row, col, c] = curve[int(min(max(light, ZERO), ONE) * FULL_SCALE + HALF)]
