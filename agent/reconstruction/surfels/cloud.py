"""Points of a surface, thinned to discs that cover it once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.extract import Mesh

Floats = NDArray[np.float64]

SPACING, RADIUS = 0.75, 0.55  # of a cell of the surface's grid: one disc for each cube so wide; its standard deviation


class Cloud(NamedTuple):
    """Discs in the world, in the order of their places."""

    place_m: Floats  # (n, 3)
    normal: Floats  # (n, 3) unit vectors, out of what is solid
    radius_m: float


def thinned(points_m: Floats, normals: Floats, cell_m: float) -> Cloud:
    """The mean of all points (n, 3) in each cube of SPACING cells; of normals (n, 3) likewise, at unit length.

    Points that are NaN, or whose normals cancel out, are left out.
    """
    good = np.isfinite(points_m).all(axis=1) & np.isfinite(normals).all(axis=1)
    points, normals = points_m[good], normals[good]
    cube = np.floor(points / (SPACING * cell_m)).astype(np.int64)
    _, which = np.unique(cube, axis=0, return_inverse=True)
    which = which.ravel()
    count = np.bincount(which)
    place, normal = (
        np.stack([np.bincount(which, weights=field[:, k]) / count for k in range(3)], axis=1)
        for field in (points, normals)
    )
    length = np.linalg.norm(normal, axis=1)
    clear = length > 0.1
    return Cloud(place[clear], normal[clear] / length[clear, None], RADIUS * cell_m)


def cloud_of(mesh: Mesh, cell_m: float) -> Cloud:
    """Discs that cover a surface that was found on cells of cell_m."""
    return thinned(mesh.vertices_m, mesh.normals.astype(float), cell_m)
