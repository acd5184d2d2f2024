"""A textured plane in the water and cameras that look at it: pictures and depths in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.reconstruction.views import Camera, View, diagonal_prior, pixel_grid, ray_slopes, rotation_of

Floats = NDArray[np.float64]

CAMERA = Camera(220.0, 79.2, 60.4, 0.4, -0.002, 160, 120)
NORMAL, OFFSET_M = np.array([0.10, -0.15, -0.98]) / np.linalg.norm([0.10, -0.15, -0.98]), -0.45  # n . p = offset


def colour(places: Floats) -> Floats:
    """Linear light (..., 3) of the plane at places (..., 3): waves of 3 to 12 cm."""
    x, y = places[..., 0], places[..., 1]
    waves = [np.sin(90 * x + 35 * y) + np.sin(110 * y), np.sin(70 * x - 60 * y), np.cos(140 * x) + np.sin(55 * y)]
    return 0.4 + 0.12 * np.stack(waves, axis=-1)


def look(view: View) -> tuple[Floats, Floats]:
    """What the view truly sees: linear light (h, w, 3), depth (h, w)."""
    slopes = ray_slopes(view.camera, pixel_grid(view.camera))
    toward = np.concatenate([slopes, np.ones_like(slopes[..., :1])], axis=-1) @ view.rotation.T
    start = view.position_m + view.camera.ahead_m * view.rotation[:, 2]
    t = (OFFSET_M - start @ NORMAL) / (toward @ NORMAL)
    return colour(start + t[..., None] * toward), t + view.camera.ahead_m


def a_view(robot: str, seq: int, position_m: Sequence[float], w_rad: Sequence[float], sigma_m: float = 4e-3) -> View:
    """A camera that looks about along z, with what it sees there."""
    prior = diagonal_prior(np.radians(0.5), 3e-3)
    nothing = np.zeros((CAMERA.height, CAMERA.width), np.float32)
    empty = np.zeros((*nothing.shape, 3), np.float32)
    at, turn = np.array(position_m, float), rotation_of(np.array(w_rad))
    blind = View(robot, "", seq, CAMERA, turn, at, prior, empty, nothing, nothing)
    light, depth = look(blind)
    fields = light.astype(np.float32), depth.astype(np.float32), np.full_like(nothing, sigma_m)
    return View(robot, "", seq, CAMERA, turn, at, prior, *fields)


def some_views() -> list[View]:
    """Three robots, two views each."""
    places = {"r1": (-0.12, 0.0), "r2": (0.10, 0.05), "r3": (0.0, -0.10)}
    return [
        a_view(robot, n, (x + 0.03 * n, y, 0.02 * n), (0.1 - 0.2 * n, 0.15 * n, 0.05))
        for robot, (x, y) in places.items()
        for n in range(2)
    ]
