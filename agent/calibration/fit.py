"""Fit what calibration measured: the focus hyperbola, and the camera with the servos of its gimbal.

The noise of a peak is in the lens position, so the hyperbola is fitted there; fitted in range, as the paper does, it
comes out 5 mm wrong at half a metre. Both fits are Gauss-Newton with Huber weights on a handful of unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.failure import Failed
from agent.kernel.config import Body
from agent.kernel.messages import Vector, upper
from agent.kernel.ranging.calibration import CameraFit, FocusFit

Array = NDArray[np.float64]

MIN_DISTANCES = 6  # three unknowns, and some to check them with
MIN_SPAN_PER_M = 2.0  # of 1/u: a shorter arc of a hyperbola is a straight line
MIN_CORNERS = 40  # five unknowns; half a board seen once
MIN_SETTINGS = 3  # of the gimbal: zero and gain of two axes
MAX_NOISE_PX = 2.0  # lens distortion that a pinhole leaves is a third of a pixel; a wrong board is worse than this
HUBER = 1.5  # residuals beyond so many standard deviations pull with constant force
HUBER_SHARE = 0.778  # what that leaves of the variance of Gaussian residuals
PASSES = 25
AHEAD_M, BREATHING = 0.005, 0.05  # what to expect, give or take: a small port; growth of the picture from far to near
PRIOR_PX = 0.1  # noise of one corner, to weigh that against the corners
NOISE_FLOOR = 5e-5  # of the positions' span: half a tenth of a step for a driver of 10 bits, none repeats better


class FocusRow(NamedTuple):
    """One accepted peak: distance of the board (z-depth from the pivot, m), lens position and half width."""

    u_m: float
    rho: float
    width: float
    sigma: float = 1.0  # standard deviation of rho beside that of the other rows; the scale is found from the residuals


class Corner(NamedTuple):
    """One corner of the board: pulses of pan and tilt, its place about the pivot in the body frame, its pixel."""

    servos_us: tuple[float, float]
    point_m: Vector
    px: tuple[float, float]
    lens_position: float = 0.0


class CalibrationRefused(Failed):
    """The measurements do not determine the fit; one line that says what to change."""


def fit_focus(rows: Sequence[FocusRow]) -> FocusFit:
    """u = u_inf + b / (rho - rho0) through the rows, by least squares in rho. Raises CalibrationRefused."""
    u, rho, sigma = (np.array([row[i] for row in rows], float) for i in (0, 1, 3))
    distances = sorted({float(d) for d in u})
    if len(distances) < MIN_DISTANCES:
        raise CalibrationRefused(f"{len(distances)} distances have a peak; measure at least {MIN_DISTANCES}")
    span = 1.0 / distances[0] - 1.0 / distances[-1]
    if span < MIN_SPAN_PER_M:
        raise CalibrationRefused(
            f"1/u spans {span:.1f} 1/m from {distances[0]:.2f} to {distances[-1]:.2f} m; "
            f"at least {MIN_SPAN_PER_M:.0f} is needed: bring the board nearer"
        )
    trust = float(np.median(sigma)) / sigma  # 1 for the row whose noise is reported
    p, normal, weights = _hyperbola(u, rho, trust)
    travel = rho - p[2]
    if float((travel * p[1]).min()) <= 0.0:
        raise CalibrationRefused("the pole of the fit lies inside the measurements; check the table for wrong peaks")
    residual = trust * (travel - p[1] / (u - p[0]))
    noise = max(_scale(weights * residual, 3), NOISE_FLOOR * float(np.ptp(rho)))
    error_m = p[0] + p[1] / travel - u
    held_out_m = np.concatenate([_held_out_m(u, rho, trust, distance) for distance in distances])
    return FocusFit(
        u_inf_m=float(p[0]),
        b_m=float(p[1]),
        rho0=float(p[2]),
        covariance=upper(noise * noise * solve(normal, np.eye(3))),
        noise=noise,
        width=float(np.median([row.width for row in rows])),
        lowest=math.floor(rho.min()),
        highest=math.ceil(rho.max()),
        r2=1.0 - float((error_m**2).sum() / ((u - u.mean()) ** 2).sum()),
        rmse_m=math.sqrt(float((error_m**2).mean())),
        held_out_rmse_m=math.sqrt(float((held_out_m**2).mean())),
    )


class LeftOut(NamedTuple):
    """How well the other distances foretell one."""

    u_m: float
    error_m: float  # rms over its rows, of the fit to all the others


def leave_one_out(rows: Sequence[FocusRow]) -> list[LeftOut]:
    """Per distance, not per row: the rows of one distance share the error of its tape measure."""
    u, rho, sigma = (np.array([row[i] for row in rows], float) for i in (0, 1, 3))
    errors = ((d, _held_out_m(u, rho, float(np.median(sigma)) / sigma, d)) for d in sorted({float(d) for d in u}))
    return [LeftOut(d, math.sqrt(float((e * e).mean()))) for d, e in errors]


def fit_camera(corners: Sequence[Corner], body: Body, size: tuple[int, int]) -> CameraFit:
    """The picture's scale, and zero and gain of pan and tilt, from a board at known places. Raises CalibrationRefused.

    The principal point stays at the image's centre: a shift of it and a turn of the gimbal look the same. Where rays
    meet shows in boards at different distances, breathing in different lens positions; what the corners do not tell
    of the two stays near nothing (a prior of a millimetre's order, and of a few percent over the lens's travel).
    """
    settings = {corner.servos_us for corner in corners}
    if len(corners) < MIN_CORNERS or len(settings) < MIN_SETTINGS:
        raise CalibrationRefused(
            f"{len(corners)} corners at {len(settings)} gimbal settings; at least {MIN_CORNERS} at {MIN_SETTINGS} are "
            "needed: light the board, and show all of it"
        )
    cx, cy = (size[0] - 1) / 2.0, (size[1] - 1) / 2.0
    nominal = np.radians((np.array([c.servos_us for c in corners]) - body.servo_centre_us) / body.servo_us_per_deg)
    points, px = np.array([c.point_m for c in corners]), np.array([c.px for c in corners])
    for axis, name in enumerate(("pan", "tilt")):
        if float(np.ptp(nominal[:, axis])) < math.radians(5.0):
            raise CalibrationRefused(f"{name} moved by less than 5 degrees; use settings further apart")

    lens_positions = np.array([c.lens_position for c in corners])
    middle, travel = float(lens_positions.mean()), max(float(np.ptp(lens_positions)), 1.0)

    def residual(p: Array) -> Array:
        """Pixels; p = f_px, pan zero, tilt zero (rad), pan gain, tilt gain, bend, ahead (m), growth over the travel."""
        pan, tilt = p[1] + p[3] * nominal[:, 0], p[2] + p[4] * nominal[:, 1]
        ahead = np.cos(pan) * points[:, 0] + np.sin(pan) * points[:, 1]
        left = np.cos(pan) * points[:, 1] - np.sin(pan) * points[:, 0]
        z = np.cos(tilt) * ahead + np.sin(tilt) * points[:, 2] - p[6]
        up = np.cos(tilt) * points[:, 2] - np.sin(tilt) * ahead
        scale = p[0] * (1.0 + p[7] * (lens_positions - middle) / travel) * (1.0 + p[5] * (left**2 + up**2) / z**2)
        seen = [cx - scale * left / z - px[:, 0], cy - scale * up / z - px[:, 1]]
        return np.concatenate([*seen, PRIOR_PX * p[6:] / (AHEAD_M, BREATHING)])

    def jacobian(p: Array) -> Array:
        steps = np.array([1e-2, 1e-6, 1e-6, 1e-6, 1e-6, 1e-5, 1e-6, 1e-6])
        both = [(residual(p + e), residual(p - e)) for e in np.diag(steps)]
        return np.stack([(plus - minus) / (2.0 * s) for (plus, minus), s in zip(both, steps, strict=True)])

    start = np.array([1.5 * size[0], 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    p, normal, weights = _gauss_newton(start, residual, jacobian)
    r, weights = residual(p)[:-2], weights[:-2]
    noise_px = _scale(weights * r, 8)
    if noise_px > MAX_NOISE_PX:
        raise CalibrationRefused(f"corners miss by {noise_px:.1f} px; check the board's squares and where it stood")
    # A whole view that is off by the same shift is a servo that did not come back to the same angle.
    shift = np.array([r.reshape(2, -1)[:, [c.servos_us == s for c in corners]].mean(axis=1) for s in sorted(settings)])
    C = max(noise_px, PRIOR_PX) ** 2 * solve(normal, np.eye(len(p)))
    return CameraFit(
        width_px=size[0],
        height_px=size[1],
        f_px=float(p[0]),
        cx_px=cx,
        cy_px=cy,
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
    )


def solve(A: Array, b: Array) -> Array:
    """A^-1 b for one small system, by elimination with pivoting: A (k, k), b (k, r). Raises CalibrationRefused."""
    M = np.concatenate([A, b], axis=1).astype(float)
    k = len(A)
    for i in range(k):
        best = i + int(np.abs(M[i:, i]).argmax())
        M[[i, best]] = M[[best, i]]
        if M[i, i] == 0.0:
            raise CalibrationRefused("the measurements do not determine the fit; vary them more")
        M[i] /= M[i, i]
        others = np.arange(k) != i
        M[others] -= M[others, i : i + 1] * M[i]
    x: Array = M[:, k:]
    return x


def _hyperbola(u: Array, rho: Array, trust: Array) -> tuple[Array, Array, Array]:
    """(u_inf, b, rho0), normal matrix and weights, started from rho u = u_inf rho + rho0 u + (b - rho0 u_inf).

    trust: (n,) one over the standard deviation of each rho.
    """
    columns = np.stack([rho, u, np.ones_like(u)])
    start = solve(_products(columns, np.ones_like(u)), (columns * (rho * u)).sum(axis=1)[:, None])[:, 0]
    u_inf = min(float(start[0]), 0.9 * float(u.min()))
    p = np.array([u_inf, start[2] + start[1] * u_inf, start[1]])

    def residual(p: Array) -> Array:
        r: Array = trust * (p[2] + p[1] / (u - p[0]) - rho)
        return r

    def jacobian(p: Array) -> Array:
        near = u - p[0]
        J: Array = trust * np.stack([p[1] / near**2, 1.0 / near, np.ones_like(u)])
        return J

    return _gauss_newton(p, residual, jacobian)


def _gauss_newton(
    p: Array, residual: Callable[[Array], Array], jacobian: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    """Minimise the Huber loss of residual(p) (n,), jacobian(p) (k, n) -> p, normal matrix, weights."""
    for _ in range(PASSES):
        r, J = residual(p), jacobian(p)
        scale = 1.4826 * float(np.median(np.abs(r))) + 1e-12
        weights = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(r), 1e-15))
        normal = _products(J, weights)
        step = solve(normal, -(J * (weights * r)).sum(axis=1)[:, None])[:, 0]
        p = p + step
        if bool((np.abs(step) <= 1e-10 * (1.0 + np.abs(p))).all()):
            break
    return p, normal, weights


def _scale(pull: Array, unknowns: int) -> float:
    """Standard deviation of the residuals from what Huber's weights left of them."""
    return math.sqrt(float((pull * pull).sum()) / (HUBER_SHARE * max(pull.size - unknowns, 1)))


def _products(J: Array, weights: Array) -> Array:
    products: Array = (J[:, None, :] * J[None, :, :] * weights).sum(axis=-1)
    return products


def _held_out_m(u: Array, rho: Array, trust: Array, distance: float) -> Array:
    """Errors in range of the rows at one distance, from the fit to all the others."""
    out = u == distance
    p, _, _ = _hyperbola(u[~out], rho[~out], trust[~out])
    error: Array = p[0] + p[1] / (rho[out] - p[2]) - u[out]
    return error
