"""A picture with what its own exposure says of its light: what is too dark to have a colour, and what too bright.

A camera that takes half the light shows half of it everywhere, and one that multiplies afterwards what its sensor gave
ends below 255: no absolute value tells a shadow from a black rim, or a bright thing from one burnt out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Light = NDArray[np.float32]

ENCODED = 2.2  # power between 8-bit values and light, as cameras encode it
LIGHT = (np.arange(256, dtype=np.float32) / 255.0) ** np.float32(ENCODED)  # of 8-bit values
BELOW = 5  # bytes below the brightest of all: from there on a plane says no more than that it is bright
FAINT = 150  # where the brightest is below, nothing has been at the sensor's limit
EVERY = 8  # of rows and columns one is enough to know the exposure
DARK = 0.01  # of the picture's bright light: vignettes of real cameras end below, what is lit lies above
BRIGHT = 0.95  # share of the pixels that are darker than what is called bright
LEAST = LIGHT[10]  # a pixel's noise and JPEG, in the light of dark ones


class Picture(NamedTuple):
    """An image (height, width, 3), blue green red, 8 bits."""

    image: Image
    dark: float  # light below which a pixel has no colour; 1 is white
    log_light: Light  # (256,) of 8-bit values; what is dark is grey
    white: int  # byte from which on a plane is burnt out


def exposed(image: Image) -> Picture:
    """The picture and its exposure."""
    some = image[::EVERY, ::EVERY].reshape(-1, 3)
    brightest = np.sort(some.max(axis=1))
    dark = max(DARK * LIGHT[brightest[int(BRIGHT * (len(brightest) - 1))]], LEAST)
    top = int(brightest[-1])
    return Picture(image, float(dark), np.log(LIGHT + np.float32(dark)), (top if top >= FAINT else 255) - BELOW)
