"""The disks that a blur is summed over: where their taps are, and what they weigh."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.raycast import Floats

Ints = NDArray[np.int64]

RADII = (0.0, 0.5, 0.8, 1.15, 1.55, 2.05, 2.7, 3.5)  # px; a mix of two neighbours has any r^2 in between
SQUARES = np.array(RADII, np.float32) ** 2
REACH = math.ceil(RADII[-1]) + 2  # pixels that the largest full sum looks to each side
NEGLIGIBLE = 3e-4  # weight below which a tap is left out
GROUP = 4  # taps summed at a time: a running sum that is stored after each of them takes twice as long


class Taps(NamedTuple):
    """The disks of RADII: disk k has taps start[k] to start[k + 1], filled up to whole groups with weights of 0."""

    start: Ints
    dy: Ints
    dx: Ints
    weight: Floats


@lru_cache(maxsize=1)
def taps() -> Taps:
    """Mean of a cubic (Keys) interpolation of the picture over each disk, which has the disk's second moment."""
    start: list[int] = [0]
    dy: list[int] = []
    dx: list[int] = []
    weight: list[float] = []
    k = np.arange(-REACH, REACH + 1)
    ring = np.sqrt((np.arange(24) + 0.5) / 24)  # equal areas
    angle = 2 * np.pi * (np.arange(64) + 0.5) / 64
    y, x = (np.outer(ring, trig(angle)).ravel() for trig in (np.sin, np.cos))
    for r in RADII:
        w = _cubic(k[:, None] - r * y) @ _cubic(k[:, None] - r * x).T / len(x)
        rows, cols = np.nonzero(np.abs(w) > NEGLIGIBLE)
        idle = [0] * (-len(rows) % GROUP)
        start.append(start[-1] + len(rows) + len(idle))
        dy.extend([*k[rows], *idle])
        dx.extend([*k[cols], *idle])
        weight.extend([*(w[rows, cols] / w[rows, cols].sum()), *idle])
    return Taps(np.array(start), np.array(dy), np.array(dx), np.array(weight, np.float32))


def _cubic(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Keys' kernel, a = -1/2: interpolates quadratics exactly."""
    t = np.abs(t)
    return np.where(t < 1, (1.5 * t - 2.5) * t * t + 1, np.where(t < 2, ((-0.5 * t + 2.5) * t - 4) * t + 2, 0))
