"""What a calibration has wrong of camera and gimbal moves all tags of all frames in one pattern: no filter averages it.

    c + f (1 + b |s|^2) s = pixel
    M ds = -((1 + b |s|^2) s dln f + |s|^2 s db + dc / f) ,  M = (1 + b |s|^2) I + 2 b s s'

The covariance of the calibration's ten numbers is taken apart into ten errors that know nothing of each other, each of
one sigma.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

from agent.core.linear_algebra import cholesky
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import Slope

NUMBERS = 10  # CameraFit.covariance


class LensError(NamedTuple):
    """One of them: how wrong all numbers are together."""

    scale: float  # of ln f, at the frame's lens position
    bend: float
    cx: float  # px over f_px
    cy: float
    ahead_m: float
    pan: float  # zeros, rad
    tilt: float
    pan_gain: float
    tilt_gain: float


def lens_errors(camera: CameraFit, focus: float | None) -> tuple[LensError, ...]:
    """None where the calibration does not say how good it is. camera: as calibrated; focus: the frame's."""
    if camera.covariance is None or (L := _factor(camera.covariance)) is None:
        return ()
    travel = 0.0 if focus is None else focus - camera.lens
    errors = []
    for k in range(NUMBERS):
        f, bend, cx, cy, ahead_m, breathing, pan, tilt, pan_gain, tilt_gain = [0.0] * k + [row[k] for row in L[k:]]
        scale, zeros = f + breathing * travel, (math.radians(pan), math.radians(tilt))
        errors.append(LensError(scale, bend, cx / camera.f_px, cy / camera.f_px, ahead_m, *zeros, pan_gain, tilt_gain))
    return tuple(errors)


@lru_cache(maxsize=64)  # of each camera that this process knows: one in an agent, all of a fleet in an experiment
def _factor(covariance: tuple[float, ...]) -> list[list[float]] | None:
    """L with L L' = covariance; None where it is none."""
    rows: list[list[float]] = []
    rest = list(covariance)
    for i in range(NUMBERS):
        rows.append([rows[k][i] for k in range(i)] + rest[: NUMBERS - i])
        del rest[: NUMBERS - i]
    return cholesky(rows)


def slope_error(error: LensError, bend: float, slope: Slope, per_m: float) -> Slope:
    """How far a point is seen from where it should be. per_m: 1 over its distance ahead of where rays meet."""
    x, y = slope
    s2 = x * x + y * y
    straight = 1.0 + bend * s2
    grown = straight * error.scale + s2 * error.bend
    u, v = grown * x + error.cx, grown * y + error.cy
    along = 2.0 * bend * (x * u + y * v) / (straight + 2.0 * bend * s2)  # M^-1, by Sherman and Morrison
    longer = error.ahead_m * per_m
    return -(u - along * x) / straight - longer * x, -(v - along * y) / straight - longer * y
