"""Calibrate a still camera of the twin against a flat wall, with the sweep and the blocks that measure depth later.

A wall square to the camera is all at one distance, so every block of the picture's middle measures the same: their
median is one row of the calibration. Looking up and down at it tells the sag of the lens.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import TiltedPeak, fit_peaks, with_sag
from agent.experiments.still_camera import StillCamera, TankView
from agent.experiments.sweeps import BLOCK_PX, facing_wall, lens_positions, sweep
from agent.perception.depth_sweep import MIN_QUALITY, clarity_of
from agent.tools.focus_calibration import FocusRow, fit_focus
from hw.camera.camera import Roi

WALL_M = 1.0 / np.linspace(1.0 / 1.35, 1.0 / 0.22, 12)  # distances of the calibration, equal steps of 1/u
WALL_REPEATS = 3  # the lens comes back to 1.2 positions (rms) at each step, which is 12 mm at 1.25 m
SAG_M = (0.36, 0.40, 0.44)  # distances at which the wall is also seen from a camera that looks up and down
SAG_TILT_DEG = 15.0  # with all of the picture's middle still on the wall
WALL_PX = 400  # side of the picture's middle that sees it


def sweeps_of_a_calibration() -> int:
    """How often `calibrate` sweeps."""
    return WALL_REPEATS * len(WALL_M) + 2 * len(SAG_M)


def calibrate(camera: StillCamera, growth: float, step: Callable[[], None]) -> FocusFit:
    """The wall square to the camera at known distances, then looking up and down at it for the lens's sag."""
    found = []
    for u_m in np.repeat(WALL_M, WALL_REPEATS).tolist():
        peak = wall_peak(camera, facing_wall(u_m), growth)
        if peak is not None:
            found.append(FocusRow(u_m, *peak))
        step()
    tilted = []
    for u_m in SAG_M:
        for tilt_deg in (-SAG_TILT_DEG, SAG_TILT_DEG):
            peak, tilt = wall_peak(camera, facing_wall(u_m, tilt_deg), growth), math.radians(tilt_deg)
            if peak is not None:
                tilted.append(TiltedPeak(u_m / math.cos(tilt), peak[0], tilt))
            step()
    return with_sag(fit_focus(found), tilted)


def wall_peak(camera: StillCamera, view: TankView, growth: float) -> tuple[float, float] | None:
    """Median peak and half width of the blocks in the picture's middle, lens positions; None where none has a peak.

    A wall has no edges in depth for the strict gate to find: it would only take blocks away, nearly all of them at the
    near end, where peaks are widest.
    """
    width, height = camera.size
    middle = Roi((width - WALL_PX) // 16 * 8, (height - WALL_PX) // 16 * 8, WALL_PX, WALL_PX)
    rho = np.array(lens_positions(camera), float)
    camera.view = view
    swept = clarity_of(sweep(camera, middle), rho, BLOCK_PX, growth)
    peaks = fit_peaks(rho, swept.clarity.reshape(len(rho), -1).T)
    good = peaks.accepted & (peaks.quality >= MIN_QUALITY)
    return (float(np.median(peaks.lens_position[good])), float(np.median(peaks.width[good]))) if good.any() else None
