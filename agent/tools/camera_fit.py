"""Fit a camera and the servos of its gimbal to corners of a board at known places.

The optical axis meets the sensor some pixels beside its middle. A turn of the gimbal moves the picture by as much, but
bends it otherwise: towards the picture's edge the two differ by a third of a pixel where the axis is 6 px off, which
puts a robot that goes by tags 10 mm beside its place. Half a thousand corners tell them apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from agent.core.config import Body
from agent.core.messages import Vector
from agent.core.ranging.camera_model import CameraFit
from agent.tools.fit import HUBER, Array, CalibrationRefused, gauss_newton, scale, solve

MIN_CORNERS = 40  # ten unknowns; half a board seen once
MIN_SETTINGS = 3  # of the gimbal: zero and gain of two axes
MAX_NOISE_PX = 2.0  # a wrong board is worse than this
# What to expect, give or take: a small port; growth of the picture from far to near; the axis, of the picture's width.
AHEAD_M, BREATHING, CENTRE = 0.005, 0.05, 0.01
PRIOR_PX = 0.1  # noise of one corner, to weigh that against the corners
PRIORS = 4  # of the unknowns, the last ones


class Corner(NamedTuple):
    """One corner of the board: pulses of pan and tilt, its place about the pivot in the body frame, its pixel."""

    servos_us: tuple[float, float]
    point_m: Vector
    px: tuple[float, float]
    lens_position: float = 0.0
    number: int | None = None  # of this corner on the board


def fit_camera(corners: Sequence[Corner], body: Body, size: tuple[int, int]) -> CameraFit:
    """The picture's scale, centre and bend, and zero and gain of pan and tilt. Raises CalibrationRefused.

    Where rays meet shows in boards at different distances, breathing in different lens positions, the centre in boards
    that fill the picture; what the corners do not tell of these stays near nothing (priors of a millimetre's order, of
    a few percent over the lens's travel, and of some pixels).
    """
    settings = {corner.servos_us for corner in corners}
    if len(corners) < MIN_CORNERS or len(settings) < MIN_SETTINGS:
        raise CalibrationRefused(
            f"{len(corners)} corners at {len(settings)} gimbal settings; at least {MIN_CORNERS} at {MIN_SETTINGS} are "
            "needed: light the board, and show all of it"
        )
    middle_px = (size[0] - 1) / 2.0, (size[1] - 1) / 2.0
    nominal = np.radians((np.array([c.servos_us for c in corners]) - body.servo_centre_us) / body.servo_us_per_deg)
    points, px = np.array([c.point_m for c in corners]), np.array([c.px for c in corners])
    for axis, name in enumerate(("pan", "tilt")):
        if float(np.ptp(nominal[:, axis])) < math.radians(5.0):
            raise CalibrationRefused(f"{name} moved by less than 5 degrees; use settings further apart")

    lens_positions = np.array([c.lens_position for c in corners])
    middle, travel = float(lens_positions.mean()), max(float(np.ptp(lens_positions)), 1.0)
    expected = AHEAD_M, BREATHING, CENTRE * size[0], CENTRE * size[0]

    def residual(p: Array) -> Array:
        """Pixels; p = f_px, pan zero, tilt zero (rad), pan gain, tilt gain, bend, ahead (m), growth over the travel,
        the axis from the picture's middle (px, px)."""
        pan, tilt = p[1] + p[3] * nominal[:, 0], p[2] + p[4] * nominal[:, 1]
        ahead = np.cos(pan) * points[:, 0] + np.sin(pan) * points[:, 1]
        left = np.cos(pan) * points[:, 1] - np.sin(pan) * points[:, 0]
        z = np.cos(tilt) * ahead + np.sin(tilt) * points[:, 2] - p[6]
        up = np.cos(tilt) * points[:, 2] - np.sin(tilt) * ahead
        f_px = p[0] * (1.0 + p[7] * (lens_positions - middle) / travel) * (1.0 + p[5] * (left**2 + up**2) / z**2)
        cx, cy = middle_px[0] + p[8], middle_px[1] + p[9]
        seen = [cx - f_px * left / z - px[:, 0], cy - f_px * up / z - px[:, 1]]
        return np.concatenate([*seen, PRIOR_PX * p[-PRIORS:] / expected])

    def jacobian(p: Array) -> Array:
        steps = np.array([1e-2, 1e-6, 1e-6, 1e-6, 1e-6, 1e-5, 1e-6, 1e-6, 1e-2, 1e-2])
        both = [(residual(p + e), residual(p - e)) for e in np.diag(steps)]
        return np.stack([(plus - minus) / (2.0 * s) for (plus, minus), s in zip(both, steps, strict=True)])

    start = np.array([1.5 * size[0], 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    p, normal, weights = gauss_newton(start, residual, jacobian)
    r, weights = residual(p)[:-PRIORS], weights[:-PRIORS]
    noise_px = scale(weights * r, len(p))
    if noise_px > MAX_NOISE_PX:
        raise CalibrationRefused(f"corners miss by {noise_px:.1f} px; check the board's squares and where it stood")
    # A whole view that is off by the same shift is a servo that did not come back to the same angle.
    shift = np.array([r.reshape(2, -1)[:, [c.servos_us == s for c in corners]].mean(axis=1) for s in sorted(settings)])
    C = _covariance(p, residual, jacobian, normal, [corner.number for corner in corners], noise_px)
    order = [0, 5, 8, 9, 6, 7, 1, 2, 3, 4]  # of CameraFit.covariance, and its units
    units = np.array([1.0 / p[0], 1.0, 1.0, 1.0, 1.0, 1.0 / travel, math.degrees(1.0), math.degrees(1.0), 1.0, 1.0])
    of_all = (units[:, None] * C[order][:, order] * units)[np.triu_indices(len(p))]
    return CameraFit(
        width_px=size[0],
        height_px=size[1],
        f_px=float(p[0]),
        cx_px=middle_px[0] + float(p[8]),
        cy_px=middle_px[1] + float(p[9]),
        bend=float(p[5]),
        ahead_m=float(p[6]),
        lens=middle,
        breathing=float(p[7]) / travel,
        scale_covariance=(float(C[0, 0] / p[0] ** 2), float(C[0, 6] / p[0]), float(C[6, 6])),
        pan_zero_deg=math.degrees(p[1]),
        tilt_zero_deg=math.degrees(p[2]),
        pan_gain=float(p[3]),
        tilt_gain=float(p[4]),
        noise_px=max(noise_px, 0.05),
        noise_deg=max(math.degrees(math.sqrt(float((shift * shift).mean())) / p[0]), 0.02),
        covariance=tuple(of_all.tolist()),
    )


def _covariance(
    p: Array,
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    normal: Array,
    numbers: Sequence[int | None],
    noise_px: float,
) -> Array:
    """Of p, px2 and so on. What the print and its grain shift a corner by, they do in every view: what is summed over
    the views of a corner is independent, not what is in each (Liang and Zeger 1986, the sandwich)."""
    inverse = solve(normal, np.eye(len(p)))
    known = [number for number in numbers if number is not None]
    if len(known) < len(numbers) or len(set(known)) <= 2 * len(p):
        return np.asarray(max(noise_px, PRIOR_PX) ** 2 * inverse, np.float64)
    r, J = residual(p), jacobian(p)
    limit = HUBER * noise_px
    r = np.clip(r, -limit, limit)
    values, group = np.unique(np.array(known), return_inverse=True)
    pulls = np.zeros((len(p), len(values)))
    for axis in range(2):
        part = slice(axis * len(known), (axis + 1) * len(known))
        for i in range(len(p)):
            pulls[i] += np.bincount(group, J[i, part] * r[part], len(values))
    K = len(values)
    meat = (pulls[:, None] * pulls[None]).sum(axis=-1) * K / (K - len(p))
    priors = J[:, -PRIORS:] * PRIOR_PX
    meat += (priors[:, None] * priors[None]).sum(axis=-1)
    out: Array = _times(_times(inverse, meat), inverse)
    return 0.5 * (out + out.T)


def _times(a: Array, b: Array) -> Array:
    out: Array = (a[:, :, None] * b[None]).sum(axis=1)
    return out
