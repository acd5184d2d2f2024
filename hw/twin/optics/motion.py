"""Motion blur: how far the picture moves while the shutter is open, and in how many parts the exposure is drawn."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hw.twin.optics.view import Moment

During = Callable[[float], Moment]  # the world at a share of the exposure, from -0.5, its start, to 0.5, its end

PART_PX = 1.5  # motion within a part, which is not drawn: below what a lens at its sharpest blurs
MOST = 8  # parts; what moves by more than 12 px is drawn a little coarser
CLOSEST_M = 0.05  # nothing comes closer to a port


def parts_of(during: During, focal_px: float, nearest_m: float) -> int:
    """Number of parts: one for each 1.5 px by which anything moves in the picture, at most.

    focal_px: pixels in a radian of water. nearest_m: z-depth of what is closest.
    """
    before, after = during(-0.5), during(0.5)
    shift_m = np.asarray(after.eye.position_m) - np.asarray(before.eye.position_m)
    turn = np.asarray(before.eye.rotation).T @ np.asarray(after.eye.rotation)
    angle_rad = math.acos(min(max((float(np.trace(turn)) - 1) / 2, -1.0), 1.0))
    moved_rad = angle_rad + float(np.linalg.norm(shift_m)) / max(nearest_m, CLOSEST_M)
    around = [(b.position_m, a.position_m, max(b.radii_m)) for b, a in zip(before.solids, after.solids, strict=True)]
    around += [(b.position_m, a.position_m, 0.0) for b, a in zip(before.hulls, after.hulls, strict=True)]
    of_others = 0.0
    for start_m, end_m, radius_m in around:
        range_m = float(np.linalg.norm(np.asarray(start_m) - np.asarray(before.eye.position_m))) - radius_m
        way_m = float(np.linalg.norm(np.asarray(end_m) - np.asarray(start_m)))
        of_others = max(of_others, way_m / max(range_m, CLOSEST_M))
    return min(max(math.ceil((moved_rad + of_others) * focal_px / PART_PX), 1), MOST)
