"""The camera model that fits a twin's lens and flat port best: exact but for what the model cannot express."""

from __future__ import annotations

import numpy as np

from agent.core.ranging.camera_model import CameraFit
from agent.experiments.sweeps import WATER_INDEX
from agent.reconstruction.views import Camera, Floats, project
from hw.twin.optics.lens import Lens
from hw.twin.optics.raycast import Optics, ray

NEAR_M, FAR_M = 0.25, 1.3
ROUNDS = 6  # of Gauss-Newton, from the data sheet's camera: each is linear but for the bend


def camera_of(lens: Lens, lens_position: float) -> CameraFit:
    """Least squares over pixels and ranges, with the lens at rest at that position."""
    pixels, points = _rays(lens, lens_position)
    f = WATER_INDEX * lens.at_position_m(lens_position) / lens.pixel_m
    found = np.array([f, *lens.centre_px, 0.39, 0.0])
    step = np.array([1e-3 * f, 1e-2, 1e-2, 1e-4, 1e-5])
    for _ in range(ROUNDS):
        rest = (pixels - _seen(found, lens, points)).ravel()
        columns = [(_seen(found + d, lens, points) - _seen(found - d, lens, points)).ravel() for d in np.diag(step)]
        jacobian = np.stack(columns, axis=1) / (2.0 * step)
        found = found + np.linalg.lstsq(jacobian, rest, rcond=None)[0]
    f_px, cx, cy, bend, ahead = found.tolist()
    return CameraFit(
        width_px=lens.width,
        height_px=lens.height,
        f_px=f_px,
        cx_px=cx,
        cy_px=cy,
        bend=bend,
        ahead_m=ahead,
        lens=lens_position,
        breathing=lens.per_position_m / lens.at_position_m(lens_position),
        noise_px=max(float(np.sqrt(np.mean(rest**2))), 1e-3),
    )


def _rays(lens: Lens, lens_position: float) -> tuple[Floats, Floats]:
    """Pixels (n, 2) and points of the camera frame (n, 3) that the twin's own rays join."""
    slope = lens.pixel_m / lens.at_position_m(lens_position)
    optics = Optics(slope, *lens.centre_px, lens.k1, lens.k2, WATER_INDEX**2, lens.port_gap_m)
    pixels, points = [], []
    for i in np.linspace(0, lens.width - 1, 17).round().astype(int).tolist():
        for j in np.linspace(0, lens.height - 1, 13).round().astype(int).tolist():
            mx, my, a, b = (float(value) for value in ray.py_func(optics, i, j))  # type: ignore[attr-defined]
            for depth in 1.0 / np.linspace(1.0 / FAR_M, 1.0 / NEAR_M, 6):
                pixels.append((i, j))
                points.append((a + depth * mx, b + depth * my, depth))
    return np.array(pixels, float), np.array(points)


def _seen(numbers: Floats, lens: Lens, points: Floats) -> Floats:
    f, cx, cy, bend, ahead = numbers.tolist()
    return project(Camera(f, cx, cy, bend, ahead, lens.width, lens.height), points)
