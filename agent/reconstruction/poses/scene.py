"""What a scene looks like by the poses that are believed: surface and discs anew from all views, in seconds."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from agent.progress import Progress
from agent.reconstruction.extract import mesh_of
from agent.reconstruction.fusion import fuse
from agent.reconstruction.stack import stacked
from agent.reconstruction.surfels.cloud import cloud_of
from agent.reconstruction.surfels.fit import fit, picture
from agent.reconstruction.view import View

Floats = NDArray[np.float64]
Look = Callable[[View], tuple[Floats, Floats]]

CELL_M = 6e-3
EPOCHS = 3


def scene_of(views: Sequence[View], progress: Progress = lambda done, total: None) -> Look:
    """Raises Failed where views have no depths."""
    surfels = fit(cloud_of(mesh_of(fuse(stacked(views, 0), CELL_M)), CELL_M), views, EPOCHS, progress)
    return lambda view: picture(surfels, view)
