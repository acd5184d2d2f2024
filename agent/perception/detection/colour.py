"""How much of a ball's colour each pixel has, beside what the water gives to everything.

Water tints: what is grey looks green in coastal water and yellow in turbid water, where red or blue goes first. So the
tint is measured in the picture itself, along its border, and divided out before colours are compared. All of it works
on light, not on 8-bit values: the gamma would press a veiled red into grey.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

from agent.kernel.config import Colour

Light = NDArray[np.float32]

DARK = 0.0055  # light of the 8-bit value 24, below which a pixel's noise counts as no colour
LIGHT = (np.arange(256, dtype=np.float32) / 255.0) ** np.float32(2.2)  # of 8-bit values, as cameras encode it
MAX_GAIN = 2.5  # a plane weaker than that holds noise, not colour

# What of blue, green, red has to be there, and what must not; the weaker of the first against the stronger of the rest.
HAS: dict[Colour, tuple[list[int], list[int]]] = {
    "red": ([2], [0, 1]),
    "yellow": ([1, 2], [0]),
    "green": ([1], [0, 2]),
}
# The same as a linear sum, nought for every grey: a profile across an edge has to be linear in light.
CONTRAST: dict[Colour, tuple[float, float, float]] = {
    "red": (-0.5, -0.5, 1.0),
    "yellow": (-1.0, 0.5, 0.5),
    "green": (-0.5, 1.0, -0.5),
}


def light(image: NDArray[np.uint8]) -> Light:
    """8-bit (height, width, 3) blue green red -> light of the same shape, 1 is white."""
    return LIGHT[image]


def share(pixels: Light, colour: Colour) -> Light:
    """(..., 3) light -> (...): (what it has - what it must not have) / (all of it); below 0 for other colours.

    Rendered balls reach 0.35 to 0.6 in air; a veil lowers it, to 0.08 for the far side of a tank of turbid water.
    """
    planes = [pixels[..., k] for k in range(3)]  # a sum over an axis of three takes four times as long
    has, lacks = ([planes[k] for k in which] for which in HAS[colour])
    score: Light = reduce(np.minimum, has) - reduce(np.maximum, lacks)
    return score / (planes[0] + planes[1] + planes[2] + DARK)


def untint(pixels: Light, colour: Colour) -> Light:
    """Gains (3,) that make the surroundings of a picture (height, width, 3) of light grey.

    Its border, for a ball in the middle covers most of a picture that was cut out around it; and of that the half
    that has least of the colour, for the ball may be cut off by the border.
    """
    border = np.concatenate([pixels[0], pixels[-1], pixels[1:-1, 0], pixels[1:-1, -1]])
    score = share(border, colour)
    tint = border[score <= np.median(score)].mean(axis=0) + DARK
    return np.clip(tint.mean() / tint, 1.0 / MAX_GAIN, MAX_GAIN).astype(np.float32)  # type: ignore[no-any-return]
