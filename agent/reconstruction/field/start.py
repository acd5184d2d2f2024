"""The grid that a field starts from: the surface of all depths, or nothing at all."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from agent.process.command import Progress
from agent.reconstruction.bricks import SIDE, Surface
from agent.reconstruction.field.volume import Box
from agent.reconstruction.fusion import fuse
from agent.reconstruction.stack import stacked
from agent.reconstruction.view import View

CELL_M = 7.5e-3  # of the grid; larger where it would have more than MOST_CELLS
MOST_CELLS = 40_000_000  # 160 MB, and three times as much for Adam
TRUNCATED_M = 30e-3  # distances beyond it say no more than that nothing is near
FOG_M = 19e-3  # with a beta of 4 mm a density of 1/m: half a tank is seen through it
LEAST_WEIGHT = 0.3  # one depth with a sigma of 18 mm


def box_of_views(views: Sequence[View], progress: Progress = lambda done, total: None) -> Box:
    """Distances to the surface that the views' depths show. Raises Failed where they show none."""
    stack, cell_m = stacked(views, 0), CELL_M
    surface = fuse(stack, cell_m, progress)
    cells = surface.table.size * SIDE**3
    if cells > MOST_CELLS:
        surface = fuse(stack, cell_m * (cells / MOST_CELLS) ** (1.0 / 3.0), progress)
    return box_of(surface)


def fog(box: Box) -> Box:
    """The same grid, but nothing known: as thin everywhere as clear water, so that light comes from anywhere."""
    return box._replace(sdf_m=np.full_like(box.sdf_m, FOG_M))


def box_of(surface: Surface) -> Box:
    """All cells of a surface's bricks and between them; what is unknown counts as far from everything."""
    shape = tuple(SIDE * count for count in surface.table.shape)
    sdf = np.full(shape, TRUNCATED_M, np.float32)
    for i, j, k in itertools.product(*(range(count) for count in surface.table.shape)):
        brick = surface.table[i, j, k]
        if brick >= 0:
            known = surface.weight[brick] > LEAST_WEIGHT
            near = np.clip(surface.distance_m[brick], -TRUNCATED_M, TRUNCATED_M)
            place = np.s_[SIDE * i : SIDE * (i + 1), SIDE * j : SIDE * (j + 1), SIDE * k : SIDE * (k + 1)]
            sdf[place] = np.where(known, near, TRUNCATED_M)
    x, y, z = surface.origin_m.tolist()
    return Box((x, y, z), surface.cell_m, sdf)
