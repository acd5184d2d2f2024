"""What may differ when vision looks at recorded frames again, and why so much.

Frames that are kept losslessly give the same numbers, but for versions of OpenCV. A JPEG is not what vision saw: its
pixels are off by one to three grey levels (sd). An edge that a lens has smeared over 20 px climbs by two to four levels
a pixel, so each of 96 rays finds it up to a pixel elsewhere, eight neighbours in a block alike, and a single outline of
a defocused ball lies 0.1 px elsewhere (rms), now and then 0.7 px. That decides nothing: of a sweep the kernel takes the
peak over all frames and the outline of the sharpest one. So what is held to limits is what the kernel decides, in units
of its own standard deviation:

* rms of the shifts of peaks and places: SHARE_RMS. An independent error of half a sigma makes a sigma 12 % larger; that
  is as far as the kernel's sigmas are off themselves (`aucamp experiment consistency`: normalised error squared 3.79
  instead of 3 beyond 0.9 m).
* each of them: SHARE_WORST, four times as much, which errors of that rms exceed once in 16,000 sweeps. What lies beyond
  is not what compression does.
* the mean shift of all outlines, which chance does not move: OUTLINE_PX, two standard deviations of what the kernel
  takes for the noise of a centre and the bias of an edge.

A change of vision by a hundredth of its clarity is none of this: it shows on the frames that are kept losslessly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.core.ranging.fix import CENTRE_NOISE_PX, EDGE_BIAS_PX

SHARE_RMS = 0.5
SHARE_WORST = 4.0 * SHARE_RMS
OUTLINE_PX = 2.0 * math.hypot(CENTRE_NOISE_PX, EDGE_BIAS_PX)
ODD = 0.01  # share of compressed frames in which a ball may be seen that is only just there, or just not

EXACT_PX = 0.01  # lossless frames: versions of OpenCV round differently
EXACT_CLARITY = 1e-4  # relative
EXACT_SHARE = 0.01  # of a sweep's sigma, where every frame is lossless


class Quantity(NamedTuple):
    """One compared quantity over a recording."""

    value: float
    allowed: float
    compared: int  # how many it is of

    @property
    def passed(self) -> bool:
        return self.value <= self.allowed

    def __str__(self) -> str:
        return f"{self.value:.2g} ({self.allowed:.2g} allowed)" + ("" if self.passed else "  <- too large")


def worst(values: Sequence[float], allowed: float) -> Quantity:
    return Quantity(max(values), allowed, len(values))


def rms(values: Sequence[float], allowed: float) -> Quantity:
    return Quantity(math.sqrt(sum(value * value for value in values) / len(values)), allowed, len(values))


def mean_shift(shifts: Sequence[tuple[float, ...]], allowed: float) -> Quantity:
    """The largest component of the mean of vectors."""
    return Quantity(max(abs(sum(column)) / len(shifts) for column in zip(*shifts, strict=True)), allowed, len(shifts))
