"""`aucamp calibrate camera`: intrinsics from photographs of a chessboard, taken in the water that will be dived in.

A flat port bends rays much as a lens with some pincushion distortion would, so the water needs no model of its own:
focal length, centre and two radial terms take it in (perception of a target near the optical axis uses the first two).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from agent.core.config import ConfigError
from agent.process.command import Progress, with_bar
from agent.tools.calibration_file import check_file, put
from hw.picture_files import picture_files, read_picture

MIN_VIEWS = 6  # six unknowns of the camera; fewer views leave focal length and distance entangled
MAX_RESIDUAL_PX = 1.5  # beyond it the squares are not what was said, or the photographs are blurred


class Intrinsics(NamedTuple):
    """Pinhole with one radial term, as OpenCV defines them; pixels from the centre of the upper left pixel."""

    width_px: int
    height_px: int
    f_px: float
    cx_px: float
    cy_px: float
    k1: float
    residual_px: float
    views: int


def calibrate_camera(
    folder: Path, columns: int, rows: int, square_mm: float, out: Path | None, console: Console
) -> Intrinsics:
    """Fit, print, and put the result into [camera] of `out` if given. Raises ConfigError, one line."""
    kept = check_file(out).get("camera", {}) if out is not None else {}
    fit = with_bar(console, "looking for the board", lambda show: intrinsics(folder, columns, rows, square_mm, show))
    corner_px = 0.5 * float(np.hypot(fit.width_px, fit.height_px))
    radius = corner_px / fit.f_px
    bend_px = corner_px * abs(fit.k1) * radius**2
    console.print(
        f"{fit.views} views: f {fit.f_px:.1f} px, centre ({fit.cx_px:.1f}, {fit.cy_px:.1f}), residual "
        f"{fit.residual_px:.2f} px, distortion {bend_px:.1f} px in the corners"
    )
    if out is not None:
        sizes = {"width_px": fit.width_px, "height_px": fit.height_px}
        lens = {"f_px": fit.f_px, "cx_px": fit.cx_px, "cy_px": fit.cy_px, "noise_px": max(fit.residual_px, 0.05)}
        # OpenCV's k1 is our bend; what else the old scale went with does not belong to the new one.
        fresh = {"bend": fit.k1, "ahead_m": 0.0, "lens": 0.0, "breathing": 0.0, "scale_covariance": [0.0, 0.0, 0.0]}
        kept = {key: value for key, value in kept.items() if key != "covariance"}  # it was of the old one
        console.print(put(out, "camera", {**kept, **sizes, **lens, **fresh}, folder))
    return fit


def intrinsics(folder: Path, columns: int, rows: int, square_mm: float, progress: Progress) -> Intrinsics:
    """Fit all photographs of a folder that show the whole board of columns x rows inner corners.

    Progress counts photographs. Raises ConfigError where they cannot be used or do not fit, one line.
    """
    paths = picture_files(folder)
    found: list[NDArray[np.float32]] = []
    size: tuple[int, int] | None = None
    for done, path in enumerate(paths, start=1):
        grey = read_picture(path, grey=True, stretch=True)  # each is looked at by itself
        if size not in (None, grey.shape[::-1]):
            raise ConfigError(f"{path}: is {grey.shape[1]}x{grey.shape[0]}, others are {size[0]}x{size[1]}")
        size = (grey.shape[1], grey.shape[0])
        seen, corners = cv2.findChessboardCornersSB(grey, (columns, rows), flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
        if seen:
            found.append(corners.astype(np.float32))
        progress(done, len(paths))
    if size is None or len(found) < MIN_VIEWS:
        raise ConfigError(
            f"{folder}: the board of {columns}x{rows} inner corners is whole in {len(found)} of {len(paths)} "
            f"photographs; {MIN_VIEWS} are needed, from different sides"
        )
    board = np.zeros((columns * rows, 3), np.float32)
    board[:, :2] = square_mm * np.mgrid[0:columns, 0:rows].T.reshape(-1, 2)
    flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3 | cv2.CALIB_FIX_ASPECT_RATIO
    start = np.array([[size[0], 0, size[0] / 2], [0, size[0], size[1] / 2], [0, 0, 1]], float)
    residual, matrix, distortion, *_ = cv2.calibrateCamera(
        [board] * len(found), found, size, start, np.zeros(5), flags=flags | cv2.CALIB_USE_INTRINSIC_GUESS
    )
    if residual > MAX_RESIDUAL_PX:
        raise ConfigError(
            f"{folder}: corners miss by {residual:.1f} px; check --columns, --rows, --square-mm and the focus"
        )
    return Intrinsics(
        *size,
        float(matrix[0, 0]),
        float(matrix[0, 2]),
        float(matrix[1, 2]),
        float(distortion.ravel()[0]),
        float(residual),
        len(found),
    )
