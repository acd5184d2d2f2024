"""Views -> surface: focus alone, then the plane sweep where it finds anything, fused with focus where it is silent.

Which of a view's depths came from where stays known: `sharpened` gives views whose depths are the best there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.process.command import Progress, Show
from agent.reconstruction.colours import coloured
from agent.reconstruction.extract import Mesh, mesh_of
from agent.reconstruction.fusion import fuse
from agent.reconstruction.raster import pieces_of, rendered
from agent.reconstruction.stack import Stack, stacked
from agent.reconstruction.stereo.neighbours import neighbours
from agent.reconstruction.stereo.plane_sweep import Swept, plane_sweep
from agent.reconstruction.view import View

CELL_M = 5e-3
PRIOR_M, PRIOR_PER_M = 4e-3, 4e-3  # sigma of a surface's depth as a prior: PRIOR_M + PRIOR_PER_M z^2
SWEEP_SHARE, FUSE_SHARE = 80, 10  # of the bar


class Built(NamedTuple):
    views: list[View]  # with the depths that the surface is made of
    mesh: Mesh
    swept: float  # share of the known depths that the plane sweep found


def build(views: Sequence[View], cell_m: float, stereo: bool, show: Show) -> Built:
    """The surface of a scene. Raises Failed where nothing has a depth."""
    given = list(views)
    share = 0.0
    if stereo:
        given, share = sharpened(given, cell_m, _part(show, 0, SWEEP_SHARE, "comparing pictures"))
    mesh = mesh_of(fuse(stacked(given, 0), cell_m, _part(show, SWEEP_SHARE, FUSE_SHARE, "fusing depths")))
    show(SWEEP_SHARE + FUSE_SHARE, 100, "triangles and colours")
    mesh = coloured(mesh, stacked(given))  # pictures come when the grid is gone: both do not have to fit the memory
    show(100, 100, "surface")
    return Built(given, mesh, share)


def sharpened(
    views: Sequence[View], cell_m: float, progress: Progress = lambda done, total: None
) -> tuple[list[View], float]:
    """The same views with depths by the plane sweep where it found any; and the share of depths that are its."""
    stack = stacked(views, 1)
    found = swept_twice(views, stack, cell_m, progress)
    both = merged(stack, found)
    better = [
        replace(view, depth_m=_cut(both.depth_m[n], view), sigma_m=_cut(both.sigma_m[n], view))
        for n, view in enumerate(views)
    ]
    return better, float(np.isfinite(found.depth_m).sum()) / max(float(np.isfinite(both.depth_m).sum()), 1.0)


def swept_twice(
    views: Sequence[View], stack: Stack, cell_m: float, progress: Progress = lambda done, total: None
) -> Swept:
    """The plane sweep about what focus says, then, where it found nothing, about the surface that came of both.

    Focus is silent or wrong beside edges in depth; the surface knows there what other views saw.
    """
    count = len(views)
    near_by = neighbours(stack)
    first = plane_sweep(stack, near_by, lambda done, total: progress(done, 2 * count))
    prior = _expected(views, mesh_of(fuse(merged(stack, first), cell_m)), stack)
    prior[np.isfinite(first.depth_m)] = np.nan
    again = stack._replace(depth_m=prior, sigma_m=PRIOR_M + PRIOR_PER_M * prior * prior)
    return plane_sweep(again, near_by, lambda done, total: progress(count + done, 2 * count), before=first.depth_m)


def _expected(views: Sequence[View], mesh: Mesh, stack: Stack) -> NDArray[np.float32]:
    """Depths (n, height, width) at which each view would see a surface; NaN where there is none."""
    found, pieces = np.full_like(stack.depth_m, np.nan), pieces_of(mesh)
    for n, view in enumerate(views):
        seen = rendered(mesh, mesh.colours, view.camera, view.rotation, view.position_m, pieces)
        found[n, : view.camera.height, : view.camera.width] = seen.depth_m
    return found


def merged(stack: Stack, found: Swept) -> Stack:
    """The depths of the plane sweep, and those of focus where it has none."""
    known = np.isfinite(found.depth_m)
    return stack._replace(
        depth_m=np.where(known, found.depth_m, stack.depth_m), sigma_m=np.where(known, found.sigma_m, stack.sigma_m)
    )


def _cut(values: np.ndarray, view: View) -> np.ndarray:
    return values[: view.camera.height, : view.camera.width]


def _part(show: Show, first: int, share: int, what: str) -> Progress:
    """A progress that is so many per cent of the whole, from `first` on."""
    return lambda done, total: show(first + share * done // max(total, 1), 100, what)
