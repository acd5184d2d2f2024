"""From clarity against lens position to a range: the peak of the curve, then the calibrated hyperbola h(rho).

The curve is matched with T(x) = a / (1 + ((x - x0)/w)^2) + b. The information about x0 sits on the flanks, which the
largest sample (the paper's argmax) and a parabola through its neighbours do not see. Lens positions need not be
equally spaced. Element-wise arithmetic and sums only: the same bits on every CPU of one class.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.ranging.calibration import FocusFit

Array = NDArray[np.float64]

MIN_POSITIONS = 5  # one more than the unknowns of the free fit
MIN_CONTRAST = 0.10  # (max - min) / max of the curve; sensor noise alone makes 0.02 to 0.03 over a 50 px block
MIN_QUALITY = 0.90  # correlation with the model; pure noise rarely passes 0.8 over a full sweep
WIDTHS = 10  # of the bank, geometric from a step to the whole span
REFINEMENTS = 8  # Gauss-Newton steps; the bank starts within half a step, three or four suffice
FARTHEST_M = 10.0  # beyond it a lens of a few millimetres cannot tell the range from infinity


class Peak(NamedTuple):
    """The sharpest lens position and how well it is known; position, sigma and width in lens positions."""

    position: float
    sigma: float  # standard deviation that the residuals leave to the position
    width: float  # half width w of the model
    quality: float  # correlation of curve and model, 0 to 1


class Refused(NamedTuple):
    reason: str


class Peaks(NamedTuple):
    """Many curves at once; every field has shape (curves,)."""

    position: Array
    sigma: Array
    width: Array
    quality: Array
    contrast: Array
    inside: NDArray[np.bool_]  # the peak lies between the second position from either end
    accepted: NDArray[np.bool_]


def fit_peak(focus: Sequence[float], clarity: Sequence[float], width: float | None = None) -> Peak | Refused:
    """The peak of one curve; with `width` only x0, a and b are fitted, which is all that a short sweep can carry."""
    if len(focus) != len(clarity) or len(set(focus)) < MIN_POSITIONS:
        return Refused(f"{len(set(focus))} lens positions, at least {MIN_POSITIONS} are needed")
    peaks = fit_peaks(np.asarray(focus, float), np.asarray([clarity], float), width)
    if peaks.accepted[0]:
        return Peak(*(float(field[0]) for field in peaks[:4]))
    if peaks.contrast[0] < MIN_CONTRAST:
        return Refused(f"flat: the contrast is {peaks.contrast[0]:.2f}, at least {MIN_CONTRAST:.2f} is needed")
    if not peaks.inside[0]:
        return Refused(f"edge: the peak at {peaks.position[0]:.0f} lies at the end of the sweep")
    return Refused(f"no single peak: the quality is {peaks.quality[0]:.2f}, at least {MIN_QUALITY:.2f} is needed")


def fit_peaks(focus: Array, curves: Array, width: float | None = None) -> Peaks:
    """The peaks of many curves taken at the same lens positions: focus (n,), curves (m, n), n >= 5."""
    x = np.asarray(focus, float)
    top = curves.max(axis=1)
    # Unit height: one tolerance fits all, and a black curve stays finite.
    y = np.asarray(curves, float) / np.where(top > 0, top, 1.0)[:, None]
    contrast = y.max(axis=1) - y.min(axis=1)
    x0, w = _search(x, y, width)
    x0, w, sse, variance = _refine(x, y, x0, w, free_width=width is None)
    deviation = y - y.mean(axis=1)[:, None]
    total = (deviation * deviation).sum(axis=1)
    quality = np.sqrt(np.clip(1.0 - sse / np.where(total > 0, total, 1.0), 0.0, 1.0)) * (total > 0)
    ordered = np.unique(x)
    inside = (x0 >= ordered[1]) & (x0 <= ordered[-2])
    accepted = inside & (quality >= MIN_QUALITY) & (contrast >= MIN_CONTRAST) & np.isfinite(variance)
    return Peaks(x0, np.sqrt(variance), w, quality, contrast, inside, accepted)


def h(fit: FocusFit, rho: float) -> float | None:
    """z-depth in metres from the gimbal pivot (paper, section 3, in the three parameters that are identifiable).

    None: at or beyond the pole, sharp at infinity as far as this lens can tell.
    """
    travel = rho - fit.rho0
    if travel * fit.b_m <= 0.0:
        return None
    u_m = fit.u_inf_m + fit.b_m / travel
    return u_m if 0.0 < u_m <= FARTHEST_M else None


def lens_position(fit: FocusFit, u_m: float) -> float:
    """The inverse of h: where an object at z-depth `u_m` is sharp. Raises ValueError at or before u_inf."""
    if u_m <= fit.u_inf_m:
        raise ValueError(f"no lens position is sharp at {u_m:.3f} m, nearer than {fit.u_inf_m:.3f} m")
    return fit.rho0 + fit.b_m / (u_m - fit.u_inf_m)


def range_variance(fit: FocusFit, rho: float, sigma_rho: float) -> tuple[float, float]:
    """Variance of h(rho) in m^2: (random, systematic).

    Random: the peak's own noise, never less than the calibration found, times (dh/drho)^2; it averages out.
    Systematic: J C J^T of the three fitted parameters; it is the same in every measurement of this robot.
    """
    travel = rho - fit.rho0
    slope = -fit.b_m / (travel * travel)  # dh/drho; also -dh/drho0
    noise = max(sigma_rho, fit.noise)
    j0, j1, j2 = 1.0, 1.0 / travel, -slope
    c00, c01, c02, c11, c12, c22 = fit.covariance
    systematic = j0 * j0 * c00 + j1 * j1 * c11 + j2 * j2 * c22 + 2.0 * (j0 * j1 * c01 + j0 * j2 * c02 + j1 * j2 * c12)
    return slope * slope * noise * noise, max(systematic, 0.0)


def _model(x: Array, x0: Array, w: Array) -> tuple[Array, Array]:
    """The template 1/(1+z^2) and z = (x - x0)/w, both (m, n)."""
    z = (x[None, :] - x0[:, None]) / w[:, None]
    return 1.0 / (1.0 + z * z), z


def _search(x: Array, y: Array, width: float | None) -> tuple[Array, Array]:
    """Matched filter: the centre and width whose zero-mean, unit-norm template correlates best with each curve."""
    low, high = float(x.min()), float(x.max())
    step = (high - low) / (np.unique(x).size - 1)
    centres = np.linspace(low, high, 2 * x.size + 1)
    widths = np.geomspace(0.7 * step, high - low, WIDTHS) if width is None else np.array([width])
    x0, w = np.repeat(centres, widths.size), np.tile(widths, centres.size)
    templates, _ = _model(x, x0, w)
    templates = templates - templates.mean(axis=1)[:, None]
    templates /= np.sqrt((templates * templates).sum(axis=1))[:, None]
    best = np.einsum("mn,tn->mt", y, templates).argmax(axis=1)  # plain einsum: not BLAS
    return x0[best], w[best]


def _refine(x: Array, y: Array, x0: Array, w: Array, free_width: bool) -> tuple[Array, Array, Array, Array]:
    """Gauss-Newton on (a, b, x0[, w]) from the bank's answer -> x0, w, sum of squares, variance of x0."""
    low, high = float(x.min()), float(x.max())
    sse, a, J = _linear(x, y, x0, w, free_width)
    for _ in range(REFINEMENTS):
        step = _solve(J[0], J[1])[..., 0]
        new_x0 = np.clip(x0 + np.clip(step[:, 2], -0.5 * w, 0.5 * w), low, high)
        new_w = w * np.clip(1.0 + step[:, 3] / w, 0.6, 1.6) if free_width else w
        new_sse, new_a, new_J = _linear(x, y, new_x0, new_w, free_width)
        better = new_sse < sse  # a curve without a peak walks nowhere: it keeps what the bank found
        x0, w, sse, a = (np.where(better, n, o) for n, o in ((new_x0, x0), (new_w, w), (new_sse, sse), (new_a, a)))
        J = tuple(np.where(better[:, None, None], n, o) for n, o in zip(new_J, J, strict=True))
        if not better.any():
            break
    unknowns = J[0].shape[-1]
    unit = np.zeros((y.shape[0], unknowns, 1))
    unit[:, 2] = 1.0
    scale = sse / max(x.size - unknowns, 1)
    variance = np.where(a > 0, scale * np.abs(_solve(J[0], unit)[:, 2, 0]), np.inf)
    return x0, w, sse, variance


def _linear(x: Array, y: Array, x0: Array, w: Array, free_width: bool) -> tuple[Array, Array, tuple[Array, ...]]:
    """Best a and b for given x0 and w -> sum of squares, a, (J^T J, J^T r) of all unknowns at that point."""
    t, z = _model(x, x0, w)
    n = x.size
    mean_t, mean_y = t.sum(axis=1) / n, y.sum(axis=1) / n
    dt, dy = t - mean_t[:, None], y - mean_y[:, None]
    a = (dt * dy).sum(axis=1) / (dt * dt).sum(axis=1)
    r = dy - a[:, None] * dt
    slope = 2.0 * a[:, None] * z * t * t / w[:, None]  # a dt/dx0; times z it is a dt/dw
    columns = [t, np.ones_like(t), slope] + ([slope * z] if free_width else [])
    J = np.stack(columns, axis=1)  # (m, unknowns, n)
    normal = (J[:, :, None, :] * J[:, None, :, :]).sum(axis=-1)
    return (r * r).sum(axis=1), a, (normal, (J * r[:, None, :]).sum(axis=-1)[..., None])


def _solve(A: Array, b: Array) -> Array:
    """A^-1 b for many small symmetric positive systems: A (m, k, k), b (m, k, r), by elimination on the diagonal."""
    A, b = A.copy(), b.copy()
    k = A.shape[-1]
    tiny = 1e-12 * np.abs(A[:, range(k), range(k)]).max(axis=1)
    for i in range(k):
        pivot = A[:, i, i]
        pivot = np.where(np.abs(pivot) > tiny, pivot, tiny + 1e-300)  # singular: a huge step, which the caller clips
        for j in range(k):
            if j != i:
                factor = A[:, j, i] / pivot
                A[:, j] -= factor[:, None] * A[:, i]
                b[:, j] -= factor[:, None] * b[:, i]
        b[:, i] /= pivot[:, None]
        A[:, i] /= pivot[:, None]
    return b
