"""Pictures with circles: white where a marked ball was found, red where one was missed, yellow where there is none."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from agent.experiments.detection.picture_run import Result, Seen
from agent.experiments.figure_files import Figures
from hw.picture_files import read_picture

SHEET_COLUMNS, ROWS = 4, 4  # of a sheet
TILE_PX = (400, 300)  # width, height
FOUND, MISSED, FALSE = (255, 255, 255), (0, 0, 255), (0, 255, 255)  # blue green red


def figures(result: Result) -> Figures:
    """Sheets of all pictures with something to show: a marked ball, or one where there is none."""
    worth = [seen for seen in result.shown if seen.outcomes or seen.false]
    for number, start in enumerate(range(0, len(worth), SHEET_COLUMNS * ROWS), start=1):
        yield f"sheet_{number:03d}.png", _sheet(worth[start : start + SHEET_COLUMNS * ROWS])


def _sheet(pictures: Sequence[Seen]) -> Figure:
    width, height = TILE_PX
    canvas = np.zeros((height * -(-len(pictures) // SHEET_COLUMNS), width * SHEET_COLUMNS, 3), np.uint8)
    for k, seen in enumerate(pictures):
        top, left = height * (k // SHEET_COLUMNS), width * (k % SHEET_COLUMNS)
        tile = _tile(seen)
        canvas[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    figure = Figure(figsize=(canvas.shape[1] / 100, canvas.shape[0] / 100), dpi=100)
    figure.figimage(canvas[..., ::-1])
    return figure


def _tile(seen: Seen) -> NDArray[np.uint8]:
    """One picture, made to fit, with its circles and its name."""
    image = read_picture(seen.path)
    scale = min(TILE_PX[0] / image.shape[1], TILE_PX[1] / image.shape[0])
    tile = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    circles = [(one.ball or one.marked, FOUND if one.ball else MISSED) for one in seen.outcomes]
    for ball, colour in circles + [(ball, FALSE) for _, ball in seen.false]:
        u, v = (round(scale * at) for at in ball.centre_px)
        cv2.circle(tile, (u, v), max(round(scale * ball.radius_px) + 2, 3), colour, 1, cv2.LINE_AA)
    cv2.putText(tile, seen.path.name, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.4, FOUND, 1, cv2.LINE_AA)
    return tile
