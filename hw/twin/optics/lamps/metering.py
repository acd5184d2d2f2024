"""Exposure as a camera module sets it in the dark: longer, until it lasts a whole frame, then more gain.

It follows the scene at once, as a module that has settled; one that still settles would change its picture in the
middle of a sweep, and is locked by whoever sweeps.
"""

from __future__ import annotations

import numpy as np

from hw.twin.optics.exposure import FULL_WELL, Exposure
from hw.twin.optics.lens import Lens
from hw.twin.optics.raycast import Floats

FRAME_NS = 1_000_000_000 // 30
ELECTRONS = 3.4e5  # of a pixel for each W/m2/sr in a colour, exposed for FRAME_NS
MAX_GAIN = 8.0  # analogue; in front of the converter, so that the converter's share of the read noise falls
LEVEL, BRIGHTEST = 0.8, 0.99  # of full scale, for the brightest 1 % of the picture's pixels in any colour
SHORTEST_NS = 20_000
METERING_STEP_PX = 16  # pixels of a frame, each way, in one of the picture that is metered


def meter(radiance: Floats) -> Exposure:
    """For a picture (h, w, 3) in W/m2/sr, however coarse."""
    top = float(np.quantile(radiance.max(axis=2), BRIGHTEST)) * ELECTRONS
    wanted = LEVEL * FULL_WELL / max(top, 1e-9)
    open_ns = min(max(round(min(wanted, 1.0) * FRAME_NS), SHORTEST_NS), FRAME_NS)
    share = open_ns / FRAME_NS
    gain = min(max(wanted / share, 1.0), MAX_GAIN)
    return Exposure(np.float32(ELECTRONS * share * gain / FULL_WELL), np.float32(gain), open_ns)


def coarse(lens: Lens) -> Lens:
    """The same camera with pixels so large."""
    x, y = ((c + 0.5) / METERING_STEP_PX - 0.5 for c in lens.centre_px)
    return lens._replace(
        pixel_m=lens.pixel_m * METERING_STEP_PX,
        width=lens.width // METERING_STEP_PX,
        height=lens.height // METERING_STEP_PX,
        centre_px=(x, y),
    )
