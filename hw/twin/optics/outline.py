"""Where in a frame a creature truly is: for who judges what was seen, never for an agent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hw.twin.optics.raycast import SOLID_ID, View, trace
from hw.twin.optics.view import Moment

Box = tuple[int, int, int, int]  # x0, y0, x1, y1 in pixels of the full frame: x0 <= x < x1, y0 <= y < y1


class Outline(NamedTuple):
    """One creature in one frame."""

    name: str
    box: Box  # around all of it that is within the frame, hidden or not
    pixels: int  # that it would cover if nothing was in front of it
    visible: int  # of these


def outlines(view: View, moment: Moment, size: tuple[int, int]) -> list[Outline]:
    """Those of the creatures that are within the frame, at `size` (width, height) pixels, in the moment's order."""
    found = []
    first = len(moment.solids) + len(moment.hulls)
    for creature in moment.creatures:
        mine = slice(first, first + len(creature.parts))
        x0, y0 = np.maximum(view.bounds[mine, :2].min(0), 0).tolist()
        x1, y1 = np.minimum(view.bounds[mine, 2:].max(0), size).tolist()
        if x1 > x0 and y1 > y0:
            alone = view._replace(**{key: getattr(view, key)[mine] for key in PER_SOLID})
            everything, itself = (_identity(each, x0, y0, x1, y1) for each in (view, alone))
            shape = itself >= SOLID_ID
            if shape.any():
                shows = shape & (everything >= SOLID_ID + mine.start) & (everything < SOLID_ID + mine.stop)
                rows, columns = np.flatnonzero(shape.any(1)), np.flatnonzero(shape.any(0))
                left, top, right, bottom = (int(i) for i in (columns[0], rows[0], columns[-1], rows[-1]))
                box = (x0 + left, y0 + top, x0 + right + 1, y0 + bottom + 1)
                found.append(Outline(creature.name, box, int(shape.sum()), int(shows.sum())))
        first = mine.stop
    return found


def swum_over(views: Sequence[View], moment: Moment, part: Box) -> Box | None:
    """The part of `part` (both x, y, width, height) that creatures may cover in any of these views; None: none."""
    first = len(moment.solids) + len(moment.hulls)
    bounds = np.concatenate([view.bounds[first:] for view in views])
    bounds = bounds[(bounds[:, 2] > bounds[:, 0]) & (bounds[:, 3] > bounds[:, 1])]
    if not len(bounds):
        return None
    x0, y0 = (max(low, int(least)) for low, least in zip(part[:2], bounds[:, :2].min(0), strict=True))
    x1 = min(part[0] + part[2], int(bounds[:, 2].max()))
    y1 = min(part[1] + part[3], int(bounds[:, 3].max()))
    return (x0, y0, x1 - x0, y1 - y0) if x1 > x0 and y1 > y0 else None


PER_SOLID = ("solids", "bounds", "radii", "up", "pattern")


def _identity(view: View, x0: int, y0: int, x1: int, y1: int) -> np.ndarray:
    depth = np.empty((y1 - y0, x1 - x0), np.float32)
    identity = np.empty(depth.shape, np.uint8)
    trace(view, x0, y0, depth, identity)
    return identity
