"""What a view is expected to show, as spots for the rule that lends lamps: places, how they face, and what they count.

Places are where rays end by the map as it is. Walls and the floor face as they do; a thing is taken to face the
camera. A place whose cell is known well enough counts nothing, and so does one that is too far to count.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

from agent.capabilities.light.frames import FrameScene, Spot
from agent.capabilities.survey.cast import cast
from agent.capabilities.survey.grid import FARTHEST_M, NEAREST_M, Grid
from agent.capabilities.survey.rays import along, place_m, rotation, slope
from agent.core.capability_messages import View
from agent.core.messages import Vector

SPOTS_ACROSS, SPOTS_DOWN = 5, 4
ON_M = 1e-6  # of a wall or the floor: a ray ends there, but for rounding
AHEAD_M = 1.0  # where lamps aim of a view that is expected to show nothing


def frame_scene(view: View, grid: Grid, cells: Mapping[int, int], stops: frozenset[int]) -> FrameScene:
    """cells, stops: of the map (CoverageMap)."""
    r, at = rotation(view.turn), place_m(view.place)
    axis, worth = along(r, (0.0, 0.0)), view.lens.cols * view.rows / (SPOTS_ACROSS * SPOTS_DOWN)
    spots = []
    for j in range(SPOTS_DOWN):
        for i in range(SPOTS_ACROSS):
            s = slope(view.lens, (i + 0.5) * view.lens.cols / SPOTS_ACROSS, (j + 0.5) * view.rows / SPOTS_DOWN)
            way = along(r, s)
            if (hit := cast(at, way, grid, stops)) is None:
                continue
            number, z_m, _ = hit
            counts = NEAREST_M < z_m < FARTHEST_M and cells.get(number, 0) < grid.goal
            there = _further(at, way, z_m)
            spots.append(Spot(there, _normal(there, way, grid.size_m), worth if counts else 0.0))
    return FrameScene(at, axis, _middle(spots) or _further(at, axis, AHEAD_M), tuple(spots), view.lens.block)


def _middle(spots: list[Spot]) -> Vector | None:
    """Of those that count."""
    whole = sum(spot.blocks for spot in spots)
    if not whole:
        return None
    x, y, z = (sum(spot.blocks * spot.at_m[k] for spot in spots) / whole for k in range(3))
    return x, y, z


def _further(at: Vector, way: Vector, z_m: float) -> Vector:
    x, y, z = (p + z_m * w for p, w in zip(at, way, strict=True))
    return x, y, z


def _normal(at_m: Vector, way: Vector, size_m: Vector) -> Vector:
    for axis, (at, size) in enumerate(zip(at_m, size_m, strict=True)):
        out = 1.0 if at < ON_M else -1.0 if at > size - ON_M else 0.0
        if out:
            x, y, z = (out if k == axis else 0.0 for k in range(3))
            return x, y, z
    length = math.sqrt(sum(w * w for w in way))
    x, y, z = (-w / length for w in way)
    return x, y, z
