"""Corners of a printed black square, where lines through its four edges meet, sharp or defocused alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from agent.core.ranging.camera_model import CameraFit
from agent.perception.landmarks.edge_line import Plane, fit_edge, room
from agent.perception.landmarks.slopes import Array, cross, to_pixels

MODULES = 8  # along the square's side: six of code between two of border
REACH = 0.9  # of a module, to either side: behind the border comes code
# Of a module, by which corners may move in the last round. In oblique views of small tags rough corners are off by as
# much as edges are looked for, and what of a gradient lies beyond that is lost: corners were wrong by up to 2.6 px.
MOVED, ROUNDS = 0.2, 4
NARROWEST_PX = 2.5  # module: a sharp edge is 2 px wide, by the pixel and by the interpolation
# Radius of blur, of a module. From a half on the border's edge and the code's are one, and from 0.54 on the corners of
# small tags were off by up to 2.4 px.
MIXED = 0.45


class Corners(NamedTuple):
    slopes: Array  # (4, 2), in the order of the rough ones
    blur_px: float  # diameter of the disc that would blur the edges as much


def light_of_bytes(gamma: float) -> Array:
    """(256,) linear light, 1 at the sensor's limit, of a camera that codes light ** (1 / gamma)."""
    light: Array = np.linspace(0.0, 1.0, 256) ** gamma
    return light


def fit_corners(plane: Plane, light: Array, rough_px: Array, camera: CameraFit) -> Corners | None:
    """Corners of a black square on white, from rough ones.

    plane: (height, width), one colour of the picture. light: of its bytes, see `light_of_bytes`. rough_px: (4, 2),
    clockwise as seen. camera: at the lens position of the picture. None where an edge leaves the picture, is covered,
    burnt out, or blurred into the code.
    """
    module = module_px(rough_px)
    if module < NARROWEST_PX:
        return None
    for _ in range(ROUNDS):
        found = _fit_once(plane, light, rough_px, camera, module)
        if found is None:
            return None
        before_px, rough_px = rough_px, to_pixels(camera, found.slopes)
        if np.abs(rough_px - before_px).max() <= MOVED * module:
            return found
    return None


def _fit_once(plane: Plane, light: Array, rough_px: Array, camera: CameraFit, module: float) -> Corners | None:
    lens = np.array([camera.f_px, camera.cx_px, camera.cy_px, camera.bend])
    work, lines, most_px2 = room(REACH * module), np.empty((4, 4)), 0.0
    for k in range(4):
        spread = fit_edge(plane, light, rough_px[k], rough_px[(k + 1) % 4], lens, work, lines[k])
        if spread < 0.0:
            return None
        most_px2 = max(most_px2, spread)
    blur_px = 4.0 * float(np.sqrt(most_px2))  # a disc's edge has a variance of a quarter of its radius squared
    corners = meeting_points(lines)
    if corners is None or blur_px > 2.0 * MIXED * module:
        return None
    return Corners(corners, blur_px)


def module_px(corners_px: Array) -> float:
    """Width of the narrowest module as its edge is crossed: in an oblique view less than an eighth of any side."""
    side = np.roll(corners_px, -1, axis=0) - corners_px
    opposite = np.roll(corners_px + 0.5 * side, -2, axis=0) - corners_px
    across = np.abs(cross(side, opposite)) / np.hypot(side[:, 0], side[:, 1])
    return float(across.min()) / MODULES


def meeting_points(lines: Array) -> Array | None:
    """(4, 2): where each of four lines (point, unit vector) meets the one before it; None where two run alike."""
    before = np.roll(lines, 1, axis=0)
    sine = cross(before[:, 2:], lines[:, 2:])
    if np.abs(sine).min() < 1e-3:
        return None
    way = cross(lines[:, :2] - before[:, :2], lines[:, 2:]) / sine
    out: Array = before[:, :2] + way[:, None] * before[:, 2:]
    return out
