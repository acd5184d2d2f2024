"""One picture that is sharp everywhere, from the frames of a sweep: for the eye alone."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from agent.core.ranging.focus import Array
from agent.perception.clarity.clarity import Edges
from hw.camera.camera import Image


def sharpest(images: Sequence[Image], grids: Sequence[tuple[Edges, Edges]], clarity: Array, reference: int) -> Image:
    """Each square of a grid from the frame in which it and its neighbours together are sharpest.

    grids: (rows, cols) of each frame, clarity (n, rows, cols). Squares differ by a pixel at most from frame to frame;
    they are laid where they are in the frame `reference`, and what no square covers is that frame's.
    """
    picture = images[reference].copy()
    around = np.array([cv2.blur(one, (3, 3), borderType=cv2.BORDER_REPLICATE) for one in clarity])
    edges = [(rows.tolist(), cols.tolist()) for rows, cols in grids]
    down, across = edges[reference]
    for row, bests in enumerate(around.argmax(axis=0).tolist()):
        for col, best in enumerate(bests):
            top, left = edges[best][0][row], edges[best][1][col]
            place = picture[down[row] : down[row + 1], across[col] : across[col + 1]]
            part = images[best][top : top + place.shape[0], left : left + place.shape[1]]
            place[: part.shape[0], : part.shape[1]] = part
    return picture
