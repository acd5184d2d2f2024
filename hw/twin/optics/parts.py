"""Parts of a frame: what of it is traced, and how much around it the blur needs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.raycast import Floats, View, trace

Part = tuple[int, int, int, int]  # x, y, width, height in the full frame

ALIGN = 4  # the coarsest pixels of the blur lie on one grid whichever part is asked for


def traced(view: View, part: Part) -> tuple[Floats, NDArray[np.uint8]]:
    """z-depth and identity (h, w) of each pixel."""
    x, y, width, height = part
    depth = np.empty((height, width), np.float32)
    identity = np.empty((height, width), np.uint8)
    trace(view, x, y, depth, identity)
    return depth, identity


def grown(part: Part, rim: int) -> Part:
    """A part and `rim` pixels around it, on the grid of the coarsest pixels."""
    x, y, width, height = part
    x0, y0 = (x - rim) // ALIGN * ALIGN, (y - rim) // ALIGN * ALIGN
    return x0, y0, -(-(x + width + rim - x0) // ALIGN) * ALIGN, -(-(y + height + rim - y0) // ALIGN) * ALIGN
