"""Calibrate a still camera of the twin against a flat wall, with the sweep and the blocks that measure depth later.

A wall square to the camera is all at one distance, so every block of the picture's middle measures the same: their
median is one row of the calibration. Looking up and down at it tells the sag of the lens.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from agent.depth_sweep import HOME_SETTLE_S, MIN_QUALITY, SETTLE_S, SWEEP_STEPS, clarity_of
from agent.experiments.still import StillCamera, View
from agent.launch import Failed
from agent.perception.breathing import measure_growth
from agent.perception.clarity import luminance
from agent.ranging.calibrate import FocusRow, fit_focus
from agent.ranging.calibration import FocusFit
from agent.ranging.focus import fit_peaks
from agent.ranging.sag import TiltedPeak, with_sag
from hw.camera import Image, Roi

BLOCK_PX = 50  # the paper's
WALL_M = 1.0 / np.linspace(1.0 / 1.35, 1.0 / 0.22, 12)  # distances of the calibration, equal steps of 1/u
WALL_REPEATS = 3  # the lens comes back to 1.2 positions (rms) at each step, which is 12 mm at 1.25 m
SAG_M = (0.36, 0.40, 0.44)  # distances at which the wall is also seen from a camera that looks up and down
SAG_TILT_DEG = 15.0  # with all of the picture's middle still on the wall
GROWTH_M = 0.5  # distance of the wall on which focus breathing is measured
WALL_PX = 400  # side of the picture's middle that sees it


def positions(camera: StillCamera) -> list[int]:
    limits = camera.focus_range()
    return [round(p) for p in np.linspace(limits.lowest, limits.highest, SWEEP_STEPS)]


def frames(camera: StillCamera, roi: Roi | None = None) -> list[Image]:
    """One sweep from the lowest position up."""
    camera.set_focus(camera.focus_range().lowest)
    camera.read(roi, settle_s=HOME_SETTLE_S)
    images = []
    for position in positions(camera):
        camera.set_focus(position)
        images.append(camera.read(roi, settle_s=SETTLE_S).image)
    return images


def breathing(camera: StillCamera) -> float:
    """Growth of the picture over a sweep, on the wall. Raises Failed where it cannot be measured."""
    camera.view = facing_wall(GROWTH_M)
    growth = measure_growth([luminance(image) for image in frames(camera)])
    if growth is None:
        raise Failed("the wall's pictures cannot be registered, so focus breathing is unknown; try another --seed")
    return growth


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


def wall_peak(camera: StillCamera, view: View, growth: float) -> tuple[float, float] | None:
    """Median peak and half width of the blocks in the picture's middle. A wall has no edges in depth for the strict
    gate to find: it would only take blocks away, nearly all of them at the near end, where peaks are widest."""
    width, height = camera.size
    middle = Roi((width - WALL_PX) // 16 * 8, (height - WALL_PX) // 16 * 8, WALL_PX, WALL_PX)
    focus = np.array(positions(camera), float)
    camera.view = view
    taken = clarity_of(frames(camera, middle), focus, BLOCK_PX, growth)
    peaks = fit_peaks(focus, taken.clarity.reshape(len(focus), -1).T)
    good = peaks.accepted & (peaks.quality >= MIN_QUALITY)
    return (float(np.median(peaks.position[good])), float(np.median(peaks.width[good]))) if good.any() else None


def facing_wall(u_m: float, tilt_deg: float = 0.0) -> View:
    """Towards the wall at the far end of the tank's x axis, `u_m` from it."""
    return View((1.5 - u_m, 0.6, 0.25), 0.0, tilt_deg)
