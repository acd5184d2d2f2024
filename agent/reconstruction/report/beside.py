"""Rendered views beside photographs that nothing was made of, and how alike they are."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.export.encoded import GAMMA, encoded
from agent.reconstruction.extract import Mesh
from agent.reconstruction.raster import Rendered, pieces_of, rendered
from agent.reconstruction.view import View

Render = Callable[[View], Rendered]  # what a view would see; pixels that it cannot tell have no depth


class Beside(NamedTuple):
    """One photograph and its rendering, (height, width, 3) red green blue bytes."""

    name: str
    photograph: NDArray[np.uint8]
    rendering: NDArray[np.uint8]
    psnr_db: float | None  # over the pixels that show the surface, of encoded light; None: none does
    shown: float  # share of the pixels that do


def render_of(mesh: Mesh) -> Render:
    """Surface colours: as the surface was seen, through as much water as the mean of the cameras that saw it."""
    pieces = pieces_of(mesh)
    return lambda view: rendered(mesh, mesh.colours, view.camera, view.rotation, view.position_m, pieces)


def beside(view: View, render: Render) -> Beside:
    """Hold a view against what is rendered for its pose."""
    seen = render(view)
    there = np.isfinite(seen.depth_m)
    photograph, rendering = encoded(view.picture), encoded(seen.picture)
    name = f"{view.robot} {view.seq}"
    return Beside(name, photograph, rendering, psnr_db(view.picture, seen.picture, there), float(there.mean()))


def psnr_db(a: NDArray[np.float32], b: NDArray[np.float32], where: NDArray[np.bool_]) -> float | None:
    """Of light encoded with 1 / 2.2, over the pixels of a mask; None where it is empty."""
    if not where.any():
        return None
    first, second = (np.clip(one[where], 0.0, 1.0).astype(float) ** (1.0 / GAMMA) for one in (a, b))
    return 10.0 * math.log10(1.0 / max(float(np.mean((first - second) ** 2)), 1e-12))
