"""Fit what calibration measured: the focus hyperbola. And how such fits are made, on a handful of unknowns: by
Gauss-Newton with Huber weights.

The noise of a peak is in the lens position, so the hyperbola is fitted there; fitted in range, as the paper does, it
comes out 5 mm wrong at half a metre.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.linear_algebra import upper
from agent.core.ranging.camera_model import FocusFit
from agent.process.command import Failed

Array = NDArray[np.float64]

MIN_DISTANCES = 6  # three unknowns, and some to check them with
MIN_SPAN_PER_M = 2.0  # of 1/u: a shorter arc of a hyperbola is a straight line
HUBER = 1.5  # residuals beyond so many standard deviations pull with constant force
HUBER_SHARE = 0.778  # what that leaves of the variance of Gaussian residuals
PASSES = 25
NOISE_FLOOR = 5e-5  # of the positions' span: half a tenth of a step for a driver of 10 bits, none repeats better


class FocusRow(NamedTuple):
    """One accepted peak: distance of the board (z-depth from the pivot, m), lens position and half width."""

    u_m: float
    rho: float
    width: float
    sigma: float = 1.0  # standard deviation of rho beside that of the other rows; the scale is found from the residuals


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
    noise = max(scale(weights * residual, 3), NOISE_FLOOR * float(np.ptp(rho)))
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

    return gauss_newton(p, residual, jacobian)


def gauss_newton(
    p: Array, residual: Callable[[Array], Array], jacobian: Callable[[Array], Array]
) -> tuple[Array, Array, Array]:
    """Minimise the Huber loss of residual(p) (n,), jacobian(p) (k, n) -> p, normal matrix, weights."""
    for _ in range(PASSES):
        r, J = residual(p), jacobian(p)
        spread = 1.4826 * float(np.median(np.abs(r))) + 1e-12
        weights = np.minimum(1.0, HUBER * spread / np.maximum(np.abs(r), 1e-15))
        normal = _products(J, weights)
        step = solve(normal, -(J * (weights * r)).sum(axis=1)[:, None])[:, 0]
        p = p + step
        if bool((np.abs(step) <= 1e-10 * (1.0 + np.abs(p))).all()):
            break
    return p, normal, weights


def scale(pull: Array, unknowns: int) -> float:
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
