"""Views -> surface: focus alone, then the plane sweep where it finds anything, fused with focus where it is silent.

Which of a view's depths came from where stays known: `sharpened` gives views whose depths are the best there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from agent.progress import Progress, Show
from agent.reconstruction.colours import coloured
from agent.reconstruction.extract import Mesh, mesh_of
from agent.reconstruction.fusion import fuse
from agent.reconstruction.neighbours import neighbours
from agent.reconstruction.stack import stacked
from agent.reconstruction.stereo import plane_sweep
from agent.reconstruction.view import View

CELL_M = 5e-3
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
        given, share = sharpened(given, _part(show, 0, SWEEP_SHARE, "comparing pictures"))
    stack = stacked(given)
    surface = fuse(stack, cell_m, _part(show, SWEEP_SHARE, FUSE_SHARE, "fusing depths"))
    show(SWEEP_SHARE + FUSE_SHARE, 100, "triangles and colours")
    mesh = coloured(mesh_of(surface), stack)
    show(100, 100, "surface")
    return Built(given, mesh, share)


def focus_surface(views: Sequence[View], cell_m: float) -> Mesh:
    """The surface by focus alone, which takes seconds. Raises Failed where nothing has a depth."""
    stack = stacked(views)
    return coloured(mesh_of(fuse(stack, cell_m)), stack)


def sharpened(views: Sequence[View], progress: Progress = lambda done, total: None) -> tuple[list[View], float]:
    """The same views with depths by the plane sweep where it found any; and the share of depths that are its."""
    stack = stacked(views)
    found = plane_sweep(stack, neighbours(stack), progress)
    known = np.isfinite(found.depth_m)
    better = [
        replace(view, depth_m=_first(found.depth_m[n], view), sigma_m=_sigma(found.sigma_m[n], view))
        for n, view in enumerate(views)
    ]
    total = sum(int(np.isfinite(view.depth_m).sum()) for view in better)
    return better, float(known.sum()) / max(total, 1)


def _first(depth: np.ndarray, view: View) -> np.ndarray:
    inside = depth[: view.camera.height, : view.camera.width]
    return np.where(np.isfinite(inside), inside, view.depth_m)


def _sigma(sigma: np.ndarray, view: View) -> np.ndarray:
    inside = sigma[: view.camera.height, : view.camera.width]
    return np.where(np.isfinite(inside), inside, view.sigma_m)


def _part(show: Show, first: int, share: int, what: str) -> Progress:
    """A progress that is so many per cent of the whole, from `first` on."""
    return lambda done, total: show(first + share * done // max(total, 1), 100, what)
