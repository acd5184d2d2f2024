"""A range from clarity against lens position: the peak of the curve, then the calibrated hyperbola h(rho).

Also the depth of field, and the shift of the peak by the lens's own weight.

The curve is matched with T(x) = a / (1 + ((x - x0)/w)^2) + b. The information about x0 sits on the flanks, which the
largest sample (the paper's argmax) and a parabola through its neighbours do not see; both are here for comparison.
Lens positions need not be equally spaced. Element-wise arithmetic and sums only: the same bits on every CPU of one
class.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.core.ranging.camera_model import CameraFit, FieldFit, FocusFit, on_sensor, ray

Array = NDArray[np.float64]
Method = Literal["matched", "parabola", "argmax"]

MIN_POSITIONS = 5  # one more than the unknowns of the free fit
MIN_CONTRAST = 0.10  # (max - min) / max of the curve; sensor noise alone makes 0.02 to 0.03 over a 50 px block
MIN_QUALITY = 0.90  # correlation with the model; pure noise rarely passes 0.8 over a full sweep
MAX_CLIMB = 0.15  # of the height: what a smoothed curve may rise again on the way down from its top
NOISE_FLOOR = 0.005  # of the height: few samples can lie on the model by chance, clarity never repeats better
# The picture grows while the lens moves, so every bit of texture wanders over the pixel grid, and the clarity of a
# region wanders with it, too slowly to show in the residuals. On the twin the peaks of nine parts of one disc differ
# by 0.41 to 0.55 half-widths over the square root of their pixels, from 0.35 to 1.2 m.
PHASE = 0.5
WIDTHS = 8  # of the bank, geometric from a step to the whole span
REFINEMENTS = 10  # Gauss-Newton steps, shortened ones counted; from the bank four or five suffice
CONVERGED = 1e-3  # of a step between lens positions
FARTHEST_M = 10.0  # beyond it a lens of a few millimetres cannot tell the range from infinity


class Peak(NamedTuple):
    """The sharpest lens position and how well it is known; sigma and width in lens positions, too."""

    lens_position: float
    sigma: float  # standard deviation that the residuals leave to it
    width: float  # half width w of the model
    quality: float  # correlation of curve and model, 0 to 1


class NoPeak(NamedTuple):
    """Why a curve gives no peak."""

    reason: str


class Peaks(NamedTuple):
    """Many curves at once; every field has shape (curves,)."""

    lens_position: Array
    sigma: Array
    width: Array
    quality: Array
    contrast: Array
    inside: NDArray[np.bool_]  # the peak lies between the second position from either end
    single: NDArray[np.bool_]  # from its top the curve falls on both sides
    accepted: NDArray[np.bool_]


class Solved(NamedTuple):
    """The model fitted to each of many curves; every field has shape (curves,)."""

    x0: Array
    width: Array
    sse: Array  # sum of squares of the residuals
    height: Array
    spread: Array  # variance of x0 for unit noise


Solve = Callable[[Array, Array, float | None], Solved]  # positions (n,) rising, curves (m, n), width or free


def fit_peak(
    lens_positions: Sequence[float], clarity: Sequence[float], width: float | None = None, method: Method = "matched"
) -> Peak | NoPeak:
    """The peak of one curve; with `width` only x0, a and b are fitted, which is all that a short sweep can carry."""
    if len(lens_positions) != len(clarity) or len(set(lens_positions)) < MIN_POSITIONS:
        return NoPeak(f"{len(set(lens_positions))} lens positions, at least {MIN_POSITIONS} are needed")
    peaks = fit_peaks(np.asarray(lens_positions, float), np.asarray([clarity], float), width, method)
    if peaks.accepted[0]:
        return Peak(*(float(field[0]) for field in peaks[:4]))
    if peaks.contrast[0] < MIN_CONTRAST:
        return NoPeak(f"flat: the contrast is {peaks.contrast[0]:.2f}, at least {MIN_CONTRAST:.2f} is needed")
    if not peaks.inside[0]:
        return NoPeak(f"edge: the peak at {peaks.lens_position[0]:.0f} lies at the end of the sweep")
    if not peaks.single[0]:
        return NoPeak("no single peak: the curve rises again on the way down from its top")
    return NoPeak(f"no single peak: the quality is {peaks.quality[0]:.2f}, at least {MIN_QUALITY:.2f} is needed")


def fit_peaks(
    lens_positions: Array,
    curves: Array,
    width: float | None = None,
    method: Method = "matched",
    solve: Solve | None = None,
) -> Peaks:
    """The peaks of many curves taken at the same lens positions: (n,) and (m, n), n >= 5.

    What is accepted does not depend on the method, so that methods can be compared on the same curves; the baselines'
    sigma is that of a peak anywhere within one step. `solve` takes the place of `_solve`.
    """
    order = np.argsort(lens_positions, kind="stable")
    x, y = np.asarray(lens_positions, float)[order], np.ascontiguousarray(np.asarray(curves, float)[:, order])
    top = y.max(axis=1)
    y = y / np.where(top > 0, top, 1.0)[:, None]  # unit height: one tolerance fits all, and a black curve stays finite
    contrast = 1.0 * (top > 0) - y.min(axis=1)
    found = (solve or _solve)(x, y, width)
    x0, w = found.x0, found.width
    deviation = y - y.mean(axis=1)[:, None]
    total = _dot(deviation, deviation)
    quality = np.sqrt(np.clip(1.0 - found.sse / np.where(total > 0, total, 1.0), 0.0, 1.0)) * (total > 0)
    unknowns = 3 if width is not None else 4
    noise2 = np.maximum(found.sse / max(x.size - unknowns, 1), (NOISE_FLOOR * contrast) ** 2)
    variance = np.where((found.height > 0) & np.isfinite(found.spread), noise2 * found.spread, np.inf)
    ordered = np.unique(x)
    inside = (x0 >= ordered[1]) & (x0 <= ordered[-2])
    single = _climb(y) <= MAX_CLIMB * contrast
    accepted = inside & single & (quality >= MIN_QUALITY) & (contrast >= MIN_CONTRAST) & np.isfinite(variance)
    if method != "matched":
        x0, variance = _top(x, y, method)
    return Peaks(x0, np.sqrt(variance), w, quality, contrast, inside, single, accepted)


def phase_sigma(width: float | Array, area_px: float) -> Any:
    """Standard deviation, lens positions, that peaks of these half widths owe to the grid under `area_px` pixels."""
    return PHASE * width / math.sqrt(area_px)


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


def range_share(fit: FocusFit, rho: float) -> float:
    """Standard deviation of the curve's range at a lens position, as a share of that range."""
    _, systematic_m2 = range_variance(fit, rho, 0.0)
    return math.sqrt(systematic_m2) / abs(fit.u_inf_m + fit.b_m / (rho - fit.rho0))


def apart(fit: FocusFit, other: FocusFit, rhos: Iterable[float]) -> tuple[float, float]:
    """Of the ranges at these lens positions that at which the other curve differs most, and by which share of it; 1:
    the other has none there."""
    ranges = [(rho, fit.u_inf_m + fit.b_m / (rho - fit.rho0)) for rho in rhos]
    return max(((u_m, abs((h(other, rho) or 0.0) / u_m - 1.0)) for rho, u_m in ranges), key=lambda one: one[1])


class _Point(NamedTuple):
    """The best fit at given x0 and w, a and b solved for; every field has shape (curves,)."""

    sse: Array  # sum of squares of the residuals
    height: Array  # a
    step_x0: Array  # full Gauss-Newton step from here
    step_w: Array
    spread: Array  # variance of x0 for unit noise


def _dot(a: Array, b: Array) -> Array:
    product: Array = np.einsum("mn,mn->m", a, b)  # plain einsum: not BLAS
    return product


def _solve(x: Array, y: Array, width: float | None) -> Solved:
    x0, w = _search(x, y, width)
    x0, w, found = _refine(x, y, x0, w, free_width=width is None)
    return Solved(x0, w, found.sse, found.height, found.spread)


def _search(x: Array, y: Array, width: float | None) -> tuple[Array, Array]:
    """Matched filter: the centre and width whose zero-mean, unit-norm template correlates best with each curve."""
    span = float(x[-1] - x[0])
    step = span / (np.unique(x).size - 1)
    centres = np.linspace(x[0], x[-1], x.size if width is None else 4 * x.size)
    widths = np.geomspace(0.7 * step, span, WIDTHS) if width is None else np.array([width])
    x0, w = np.repeat(centres, widths.size), np.tile(widths, centres.size)
    templates = 1.0 / (1.0 + ((x[None, :] - x0[:, None]) / w[:, None]) ** 2)
    templates -= templates.mean(axis=1)[:, None]
    templates /= np.sqrt(_dot(templates, templates))[:, None]
    best = np.einsum("mn,tn->mt", y, templates).argmax(axis=1)
    return x0[best], w[best]


def _refine(x: Array, y: Array, x0: Array, w: Array, free_width: bool) -> tuple[Array, Array, _Point]:
    """Gauss-Newton on x0 (and w) from the bank's answer; one that makes the fit worse is halved and tried again."""
    dy = y - y.mean(axis=1)[:, None]
    tolerance = CONVERGED * float(x[-1] - x[0]) / x.size
    here, share, active = _at(x, dy, x0, w, free_width), np.ones(len(y)), np.ones(len(y), bool)
    for _ in range(REFINEMENTS):
        new_x0 = np.clip(x0 + share * np.clip(here.step_x0, -0.5 * w, 0.5 * w), x[0], x[-1])
        new_w = w * np.clip(1.0 + share * here.step_w / w, 0.6, 1.6)
        there = _at(x, dy, new_x0, new_w, free_width)
        better = active & (there.sse < here.sse)
        active &= np.maximum(np.abs(new_x0 - x0), np.abs(new_w - w)) >= tolerance  # each curve by itself
        x0, w = np.where(better, new_x0, x0), np.where(better, new_w, w)
        here = _Point(*(np.where(better, new, old) for new, old in zip(there, here, strict=True)))
        share = np.where(better, np.minimum(2.0 * share, 1.0), 0.5 * share)
        if not active.any():
            break
    return x0, w, here


def _at(x: Array, dy: Array, x0: Array, w: Array, free_width: bool) -> _Point:
    """The fit at x0 and w (m,) to the zero-mean curves dy (m, n).

    a and b are eliminated (variable projection, Golub and Pereyra 1973): left is a system of two unknowns, whose
    columns are the derivatives without what a and b can explain of them.
    """
    n = x.size
    z = (x[None, :] - x0[:, None]) / w[:, None]
    t = 1.0 / (1.0 + z * z)
    dt = t - (t.sum(axis=1) / n)[:, None]
    tt = _dot(dt, dt)
    a = _dot(dt, dy) / tt
    r = dy - a[:, None] * dt
    s = z * t * t  # dT/dx0 over k
    q = s * z  # dT/dw over k
    k = 2.0 * a / w
    st, sr = _dot(s, dt), _dot(s, r)
    ss = np.maximum(_dot(s, s) - s.sum(axis=1) ** 2 / n - st * st / tt, 0.0)
    if not free_width:
        return _Point(_dot(r, r), a, _ratio(sr, k * ss), np.zeros_like(a), _ratio(1.0, k * k * ss))
    qt, qr, q_sum = _dot(q, dt), _dot(q, r), q.sum(axis=1)
    qq = np.maximum(_dot(q, q) - q_sum**2 / n - qt * qt / tt, 0.0)
    sq = _dot(s, q) - s.sum(axis=1) * q_sum / n - st * qt / tt
    determinant = np.maximum(ss * qq - sq * sq, 1e-12 * np.abs(ss * qq) + 1e-300)
    return _Point(
        sse=_dot(r, r),
        height=a,
        step_x0=_ratio(qq * sr - sq * qr, k * determinant),
        step_w=_ratio(ss * qr - sq * sr, k * determinant),
        spread=_ratio(qq, k * k * determinant),
    )


def _ratio(numerator: Array | float, denominator: Array) -> Array:
    """Finite for a curve without height: a huge step, which the caller clips, a huge variance."""
    ratio: Array = numerator / np.where(denominator == 0.0, 1e-300, denominator)
    return np.nan_to_num(ratio, nan=0.0, posinf=1e300, neginf=-1e300)


def _climb(y: Array) -> Array:
    """How much each curve, smoothed over three samples, rises again at most on the way down from its top (m,)."""
    smooth = y.copy()
    smooth[:, 1:-1] = (y[:, :-2] + y[:, 1:-1] + y[:, 2:]) / 3.0
    top = smooth.argmax(axis=1)[:, None]
    k = np.arange(y.shape[1])[None, :]
    height = np.take_along_axis(smooth, top, axis=1)
    right, left = np.where(k >= top, smooth, height), np.where(k <= top, smooth, height)[:, ::-1]
    climbs = [(side - np.minimum.accumulate(side, axis=1)).max(axis=1) for side in (right, left)]
    climb: Array = np.maximum(*climbs)
    return climb


def _top(x: Array, y: Array, method: Method) -> tuple[Array, Array]:
    """The baselines: the largest sample, or the top of the parabola through the logarithms of it and its neighbours."""
    m, best = np.arange(len(y)), y.argmax(axis=1)
    i = np.clip(best, 1, x.size - 2)
    variance = ((x[i + 1] - x[i - 1]) / 2.0) ** 2 / 12.0
    if method == "argmax":
        return x[best], variance
    left, mid, right = (np.log(np.maximum(y[m, i + k], 1e-12)) for k in (-1, 0, 1))
    h1, h2 = x[i] - x[i - 1], x[i + 1] - x[i]
    d1, d2 = (mid - left) / np.where(h1 > 0, h1, 1.0), (right - mid) / np.where(h2 > 0, h2, 1.0)
    bend = (d2 - d1) / np.where(h1 + h2 > 0, h1 + h2, 1.0)
    convex = (bend < 0) & (best == i)
    top = x[i] - (d1 + bend * h1) / (2.0 * np.where(convex, bend, -1.0))
    return np.where(convex, np.clip(top, x[i - 1], x[i + 1]), x[best]), variance


# --- off the axis, through a flat port ---
#
# A flat port refracts by angle. Off the axis it makes a point look nearer, and not equally near to both of the pencil's
# fans: with k = cos a / cos w, a and w the chief ray's angles in air and in water, the sagittal fan is sharp as if at
# p + (z - p) k / n and the tangential one as if at p + (z - p) k^3 / n. Clarity peaks between them, at
# p + K (z - p) / n with K = k^3 / (q + (1 - q) k^2), q the share of the gradients' energy that points away from the
# axis, 1/2 for texture that runs in all directions. h(rho), which is found on the axis, then reads p + K (z - p). A
# dome and air have K = 1: there what is left is the lens's own.

WATER_INDEX = 1.333  # sea water's 0.007 more makes 1 mm at 1 m and 24 degrees
FLAT_PORT = 0.2  # of `bend`, from which on a port is flat and in water: it makes 0.39, a lens's own rarely half of that
PORT_M = 0.010  # from the pivot to the port: 10 mm more or less make 1 mm at 1 m and 24 degrees
STEEPEST = 0.95  # of a ray's sine in air
ANY_WAY = 0.5  # q of texture that runs in all directions


def port_share(camera: CameraFit, px: tuple[float, float], outward: float = ANY_WAY) -> float:
    """K of the direction of a pixel: 1 on the axis, less off it. outward: q of what is seen there."""
    return share_at(camera, ray(camera, px)[2], outward)


def share_at(camera: CameraFit, cos_water: float, outward: float = ANY_WAY) -> float:
    """The same by the cosine of a ray's angle to the axis, in water."""
    if camera.bend < FLAT_PORT:
        return 1.0
    sine2 = min(WATER_INDEX * WATER_INDEX * (1.0 - cos_water * cos_water), STEEPEST * STEEPEST)
    k = math.sqrt((1.0 - sine2) / (1.0 - sine2 / (WATER_INDEX * WATER_INDEX)))
    return k * k * k / (outward + (1.0 - outward) * (k * k))


def through_port(u_m: float, share: float) -> float:
    """The z-depth from the pivot of what h(rho) takes to be at u_m, in a direction of this share K."""
    return PORT_M + (u_m - PORT_M) / share


def as_on_axis(z_m: float, share: float) -> float:
    """The inverse: what h(rho) makes of something at a z-depth."""
    return PORT_M + (z_m - PORT_M) * share


# --- lens sag ---
# The lens's own weight: looking up, it sinks towards the sensor, and the peak of every sweep lies a little elsewhere.
#
# A voice coil holds its lens on springs, so the shift is proportional to the component of gravity along the optical
# axis. A micrometre at the vertical is five to eight lens positions of a small module, 10 mm at half a metre: more than
# all that averages out. It is measured by repeating a distance with the camera looking up and down.

UNKNOWN_SAG = 0.05  # of the peak's half width, standard deviation where it was not measured: a micrometre of sag
MIN_SPREAD = math.sin(math.radians(10.0))  # of sin(tilt), from the lowest to the highest view: less shows only noise


class TiltedPeak(NamedTuple):
    """A peak found with the camera looking up by `tilt_rad`; u_m is z-depth from the pivot along the tilted axis."""

    u_m: float
    rho: float
    tilt_rad: float


def at_tilt(fit: FocusFit, tilt_rad: float) -> FocusFit:
    """The same lens looking up by `tilt_rad`: all its peaks shift alike, so rho0 does. How well the sag is known
    joins the variance of rho0, hence what does not average out."""
    up = math.sin(tilt_rad)
    sigma = UNKNOWN_SAG * fit.width if fit.sag_sigma is None else fit.sag_sigma
    return _shifted(fit, fit.sag * up, (sigma * up) ** 2)


def _shifted(fit: FocusFit, by: float, variance: float) -> FocusFit:
    """A lens all of whose peaks lie elsewhere by so much."""
    xx, xy, xz, yy, yz, zz = fit.covariance
    return replace(fit, rho0=fit.rho0 + by, covariance=(xx, xy, xz, yy, yz, zz + variance))


def with_sag(fit: FocusFit, peaks: Sequence[TiltedPeak]) -> FocusFit:
    """`fit` with the sag that these peaks show; as it was where they do not differ enough in tilt.

    A straight line of the peaks' shift against sin(tilt). Its intercept is left free: what warmed up since the
    distances were taken is not sag. Peaks of one tilt and distance are one, for they share what the tape has wrong.
    """
    alike: dict[tuple[float, float], list[float]] = {}
    for peak in peaks:
        alike.setdefault((peak.tilt_rad, peak.u_m), []).append(peak.rho - lens_position(fit, peak.u_m))
    up, shift = [math.sin(tilt_rad) for tilt_rad, _ in alike], [sum(own) / len(own) for own in alike.values()]
    if len(up) < 3 or max(up) - min(up) < MIN_SPREAD:
        return fit
    mean_up, mean_shift = sum(up) / len(up), sum(shift) / len(shift)
    spread = sum((s - mean_up) ** 2 for s in up)
    sag = sum((s - mean_up) * (r - mean_shift) for s, r in zip(up, shift, strict=True)) / spread
    rest = sum((r - mean_shift - sag * (s - mean_up)) ** 2 for s, r in zip(up, shift, strict=True))
    noise = max(math.sqrt(rest / (len(up) - 2)), fit.noise)
    return replace(fit, sag=sag, sag_sigma=noise / math.sqrt(spread))


# --- field: what is sharp aside ---
# A sensor that is not square to the optical axis tilts the plane that is sharp, and most lenses curve it. On the sensor
# both are the same at all distances: the peaks of a direction are shifted by one number of lens positions. A dome in
# water has a curved field, too, with the same form.
#
# The share K of a flat port is no part of it: that is a factor of the depth.


def in_direction(fit: FocusFit, camera: CameraFit, px: tuple[float, float], rho: float) -> FocusFit:
    """The lens as it is in the direction of a pixel of the camera's picture, for what is sharp at rho. How well the
    field is known joins the variance of rho0."""
    field = fit.field
    if field is None:
        return fit
    x, y = on_sensor(camera, px, rho)
    r2 = x * x + y * y
    xx, xy, xr, yy, yr, rr = field.covariance
    variance = x * x * xx + y * y * yy + r2 * r2 * rr + 2.0 * (x * y * xy + x * r2 * xr + y * r2 * yr)
    return _shifted(fit, shift(field, (x, y)), max(variance, 0.0))


def shift(field: FieldFit, aside: tuple[float, float]) -> float:
    """Lens positions by which the peaks of a place `on_sensor` lie beyond those on the axis."""
    x, y = aside
    return field.right * x + field.down * y + field.curved * (x * x + y * y)
