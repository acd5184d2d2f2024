"""Motion blur: how far the picture moves while the shutter is open, and in how many parts the exposure is drawn."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hw.twin.optics.view import Moment

During = Callable[[float], Moment]  # the world at a share of the exposure, from -0.5, its start, to 0.5, its end

PART_PX = 1.5  # motion within a part, which is not drawn: below what a lens at its sharpest blurs
MOST = 8  # parts; what moves by more than 12 px is drawn a little coarser
CLOSEST_M, LARGEST_M = 0.05, 0.14  # nothing comes closer to a port; the radius of a hull, and more than most solids'


def parts_of(during: During, focal_px: float, nearest_m: float) -> int:
    """Number of parts: one for each 1.5 px by which anything moves in the picture, at most.

    focal_px: pixels in a radian of water. nearest_m: z-depth of what is closest.
    """
    before, after = during(-0.5), during(0.5)
    shift_m = np.asarray(after.eye.position_m) - np.asarray(before.eye.position_m)
    turn = np.asarray(before.eye.rotation).T @ np.asarray(after.eye.rotation)
    angle_rad = math.acos(min(max((float(np.trace(turn)) - 1) / 2, -1.0), 1.0))
    moved_rad = angle_rad + float(np.linalg.norm(shift_m)) / max(nearest_m, CLOSEST_M)
    of_others = 0.0
    for start_m, end_m in zip(_places_m(before), _places_m(after), strict=True):
        range_m = float(np.linalg.norm(start_m - np.asarray(before.eye.position_m))) - LARGEST_M
        of_others = max(of_others, float(np.linalg.norm(end_m - start_m)) / max(range_m, CLOSEST_M))
    return min(max(math.ceil((moved_rad + of_others) * focal_px / PART_PX), 1), MOST)


def _places_m(moment: Moment) -> list[NDArray[np.float64]]:
    solids = [np.asarray(solid.position_m, float) for solid in moment.solids]
    hulls = [np.asarray(hull.position_m, float) for hull in moment.hulls]
    parts = [np.asarray(part.position_m, float) for creature in moment.creatures for part in creature.parts]
    return solids + hulls + parts
