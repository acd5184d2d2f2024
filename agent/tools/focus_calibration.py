"""`aucamp calibrate focus`: a table of (range, sharpest lens position) -> h(rho), its worth, and a verdict in words.
The fits that calibration uses, and the calibration file with its parts.
"""

from __future__ import annotations

import itertools
import math
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec
import numpy as np
import tomli_w
from msgspec.structs import replace
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table
from scipy.special import ndtri, stdtrit

from agent.core.config import ConfigError, convert, read_toml, write_whole
from agent.core.linear_algebra import upper
from agent.core.ranging import focus
from agent.core.ranging.camera_model import CameraFit, FieldFit, FocusFit, TimingFit, at_lens_position, on_sensor
from agent.core.ranging.focus import TiltedPeak, as_on_axis, lens_position, port_share, shift, with_sag
from agent.process.command import Failed, free_name
from hw.camera.files import read_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# --- fits ---
# Fit what calibration measured: the focus hyperbola. And how such fits are made, on a handful of unknowns: by Gauss-
# Newton with Huber weights.
#
# The noise of a peak is in the lens position, so the hyperbola is fitted there; fitted in range, as the paper does,
# it comes out 5 mm wrong at half a metre.

Array = NDArray[np.float64]

MIN_DISTANCES = 6  # three unknowns, and some to check them with
MIN_SPAN_PER_M = 2.0  # of 1/u: a shorter arc of a hyperbola is a straight line
BESIDE, VAGUE = 6.0, 1 / 6  # standard deviations of a wrong peak; least weight of any, where 1 is typical
MOST_WRONG = 4  # distances
HUBER = 1.5  # residuals beyond so many standard deviations pull with constant force
HUBER_SHARE = 0.778  # what that leaves of the variance of Gaussian residuals
PASSES = 25
FIELD_KNOWN = 0.1  # of a peak's half width, standard deviation of its shift anywhere: 10 mm at half a metre
FIELD_UNTOLD = "these peaks do not tell the field from the curve: take each sweep all over the picture"
SURE_DISTANCES = 8  # of fewer, how sure the curve is said to be is itself hardly known
FIELD_PASSES = 4  # over curve and field in turn
NOISE_FLOOR = 5e-5  # of the positions' span: half a tenth of a step for a driver of 10 bits, none repeats better


class FocusRow(NamedTuple):
    """One accepted peak: distance of the board (z-depth from the pivot, m), lens position and half width."""

    u_m: float
    rho: float
    width: float
    sigma: float = 1.0  # standard deviation of rho, as the peak tells; the fit finds its scale from the residuals
    tape_m: float = 0.0  # as measured, where u_m is what a port makes of it; 0: u_m


class CalibrationRefused(Failed):
    """The measurements do not determine the fit; one line that says what to change."""


def fit_focus(rows: Sequence[FocusRow]) -> FocusFit:
    """u = u_inf + b / (rho - rho0) through the rows, by least squares in rho. Raises CalibrationRefused.

    Its covariance says how far leaving out a distance moves it (the jackknife, Tukey 1958): what a tape has wrong is
    alike in all peaks at one, and the nearer, the more lens positions. Of few it is as much wider as Student's t is
    than the normal distribution, at 95 %.
    """
    u, rho, sigma = (np.array([row[i] for row in rows], float) for i in (0, 1, 3))
    tape_m = np.array([row.tape_m or row.u_m for row in rows])
    distances = sorted({*tape_m.tolist()})
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
    without = [_held_out(u, rho, trust, tape_m == distance) for distance in distances]
    error_m, held_out_m = p[0] + p[1] / travel - u, np.concatenate([error_m for _, error_m in without])
    free, moved = len(distances) - 3, np.stack([other - p for other, _ in without], axis=1)
    wider = float(stdtrit(free, 0.975) / ndtri(0.975))
    C = wider**2 * (1.0 - 1.0 / len(distances)) * _products(moved, np.ones(len(distances)))
    C += (NOISE_FLOOR * float(np.ptp(rho))) ** 2 * solve(normal, np.eye(3))
    return FocusFit(
        u_inf_m=float(p[0]),
        b_m=float(p[1]),
        rho0=float(p[2]),
        covariance=upper(C),
        noise=noise,
        width=float(np.median([row.width for row in rows])),
        lowest=math.floor(rho.min()),
        highest=math.ceil(rho.max()),
        r2=1.0 - float((error_m**2).sum() / ((u - u.mean()) ** 2).sum()),
        rmse_m=math.sqrt(float((error_m**2).mean())),
        held_out_rmse_m=math.sqrt(float((held_out_m**2).mean())),
    )


class Aside(NamedTuple):
    """The peak of one place in the picture, of a sweep that shows many."""

    sweep: int
    u_m: float  # z-depth from the pivot of what is seen there, as h(rho) on the axis takes it: see `focus.as_on_axis`
    on_sensor: tuple[float, float]  # where it is seen, by `camera_model.on_sensor`
    rho: float
    sigma: float  # of rho beside that of the other places


def fit_field(fit: FocusFit, places: Sequence[Aside]) -> FieldFit:
    """How peaks aside differ from those on the axis. Each sweep has a shift of its own: no lens comes back quite to
    where it was. Raises CalibrationRefused."""
    sweeps = sorted({place.sweep for place in places})
    x, y = np.array([place.on_sensor for place in places]).T
    sigma = np.array([place.sigma for place in places])
    trust = float(np.median(sigma)) / sigma
    off = np.array([place.rho - lens_position(fit, place.u_m) for place in places])
    own = np.array([[place.sweep == sweep for place in places] for sweep in sweeps], float)
    terms = np.stack([x, y, x * x + y * y])
    J = trust * np.concatenate([terms, own])  # (3 + sweeps, places)
    try:
        p, normal, weights = gauss_newton(np.zeros(len(J)), lambda p: p @ J - trust * off, lambda p: J)
        inverse = solve(normal, np.eye(len(J)))
    except CalibrationRefused:
        raise CalibrationRefused(FIELD_UNTOLD) from None
    noise = max(scale(weights * (p @ J - trust * off), len(J)), NOISE_FLOOR * float(fit.highest - fit.lowest))
    known = noise * noise * inverse
    if not float(np.einsum("kn,km,mn->n", terms, known[:3, :3], terms).max()) < (FIELD_KNOWN * fit.width) ** 2:
        raise CalibrationRefused(FIELD_UNTOLD)
    return FieldFit(right=float(p[0]), down=float(p[1]), curved=float(p[2]), covariance=upper(known[:3, :3]))


class LeftOut(NamedTuple):
    """How well the other distances foretell one."""

    u_m: float
    error_m: float  # rms over its rows, of the fit to all the others


def leave_one_out(rows: Sequence[FocusRow]) -> list[LeftOut]:
    """Per distance, not per row: the rows of one distance share the error of its tape measure."""
    u, rho, sigma = (np.array([row[i] for row in rows], float) for i in (0, 1, 3))
    tape_m, trust = np.array([row.tape_m or row.u_m for row in rows]), float(np.median(sigma)) / sigma
    errors = ((d, _held_out(u, rho, trust, tape_m == d)[1]) for d in sorted({*tape_m.tolist()}))
    return [LeftOut(d, math.sqrt(float((e * e).mean()))) for d, e in errors]


def told_apart(rows: Sequence[FocusRow]) -> tuple[list[FocusRow], list[FocusRow]]:
    """Rows, and those whose peak is vague or by far beside what most foretell: not the board's. Most are those near the
    curve of three that has the least median of errors (Rousseeuw 1984). Raises CalibrationRefused for many."""
    if len(rows) < MIN_DISTANCES:
        return list(rows), []
    u, rho, sigma = (np.array([row[i] for row in rows], float) for i in (0, 1, 3))
    trust = np.minimum(np.median(sigma) / sigma, 1.0)
    three = np.array(list(itertools.combinations(range(len(rows)), 3)))
    terms = np.stack([rho, u, np.ones_like(u)], axis=1)  # rho u = u_inf rho + rho0 u + b - rho0 u_inf
    u_inf, rho0, rest = (np.linalg.pinv(terms[three]) @ (rho * u)[three][..., None])[..., 0].T[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):  # where a curve has its pole
        off = np.nan_to_num(trust * np.abs(rho0 + (rest + rho0 * u_inf) / (u - u_inf) - rho), nan=np.inf)
    best = off[np.argmin(np.median(off, axis=1))]
    least = float(np.median(sigma))  # of the noise: a few may lie on one curve by chance
    near = best <= BESIDE * max(float(np.median(best)), least)
    fit = fit_focus([*itertools.compress(rows, near)])
    beside = trust * np.abs(rho - [lens_position(fit, one) for one in u]) > BESIDE * max(fit.noise, least)
    wrong = list(itertools.compress(rows, beside | (trust < VAGUE)))
    if len(wrong) > MOST_WRONG:
        places = ", ".join(f"{row.u_m:.2f}" for row in wrong)
        raise CalibrationRefused(
            f"the peaks at {places} m do not fit the others; let the board stand alone in the picture's middle"
        )
    return [row for row in rows if row not in wrong], wrong


def solve(A: Array, b: Array) -> Array:
    """A^-1 b for one small system, by elimination with pivoting: A (k, k), b (k, r). Raises CalibrationRefused.

    By single numbers: of so few, arrays take twenty times as long.
    """
    rows: list[list[float]] = np.concatenate([A, b], axis=1).astype(float).tolist()
    k = len(rows)
    for i in range(k):
        best = max(range(i, k), key=lambda j: abs(rows[j][i]))
        rows[i], rows[best] = rows[best], rows[i]
        pivot = rows[i][i]
        if pivot == 0.0:
            raise CalibrationRefused("the measurements do not determine the fit; vary them more")
        rows[i] = own = [value / pivot for value in rows[i]]
        for j in range(k):
            if j != i:
                times = rows[j][i]
                rows[j] = [value - times * of_own for value, of_own in zip(rows[j], own, strict=True)]
    return np.array([row[k:] for row in rows])


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
        off, half = np.abs(r), r.size // 2
        middle = np.sort(off)[half - 1 + r.size % 2 : half + 1]  # np.median takes longer than all else
        spread = 1.4826 * float(middle.mean()) + 1e-12
        weights = np.minimum(1.0, HUBER * spread / np.maximum(off, 1e-15))
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


def _held_out(u: Array, rho: Array, trust: Array, out: NDArray[np.bool_]) -> tuple[Array, Array]:
    """The fit to all rows but those that are out, and their errors in range from it."""
    p, _, _ = _hyperbola(u[~out], rho[~out], trust[~out])
    error: Array = p[0] + p[1] / (rho[out] - p[2]) - u[out]
    return p, error


# --- the fit of how late frames are stamped, and how slowly the lens goes ---

LATES_S = np.linspace(-0.02, 0.25, 109)  # among which the lateness is looked for, and logarithms of lags
LOG_LAGS = np.log(np.geomspace(0.001, 0.3, 60))
LEAST_MISS, MOST_MISS = 0.02, 0.15  # rms of the fit, of a step's change of clarity
TIME_FLOOR_S = 0.001  # an exposure is no moment, and no lens moves quite so


def fit_timing(positions: Array, curve: Array, since_s: Array, seen: Array) -> TimingFit:
    """`curve` (n,): clarity at rest at positions (n,), rising; `seen` (m,): of frames that are stamped since_s (m,)
    after the lens was told to go from the first position to the last. Raises CalibrationRefused where they do not fit.

    Mean and deviation over all pairs of lateness and lag, each as likely as the frames are with it: a swift lens in
    frames that are not late shows no more than that both are small.
    """
    height, way = float(np.ptp(curve)), positions[-1] - positions[0]
    lates, lags = LATES_S, LOG_LAGS
    for _ in range(2):  # roughly, then where it is
        gone = 1.0 - np.exp(-np.maximum(since_s - lates[:, None, None], 0.0) / np.exp(lags)[:, None])
        misses = (np.interp(positions[0] + gone * way, positions, curve) - seen) / height
        cost = np.square(misses).sum(axis=2)  # (lates, lags)
        rms = math.sqrt(float(cost.min()) / max(len(seen) - 2, 1))
        likely = np.exp(-0.5 * (cost - cost.min()) / max(rms, LEAST_MISS) ** 2)
        (late, late_sigma), (lag, lag_sigma) = (
            _moments(axis, likely.sum(axis=1 - k)) for k, axis in enumerate((lates, lags))
        )
        lates, lags = (
            at + np.linspace(-4.0, 4.0, 81) * max(sigma, 0.5 * float(axis[1] - axis[0]))
            for at, sigma, axis in ((late, late_sigma, lates), (lag, lag_sigma, lags))
        )
    if rms > MOST_MISS:
        raise CalibrationRefused(
            f"the lens's timing: pictures are off by {100 * rms:.0f} % of a step's clarity; keep board and light still"
        )
    lag_s = math.exp(lag)
    return TimingFit(
        stamp_late_s=late,
        stamp_late_sigma_s=math.hypot(late_sigma, TIME_FLOOR_S),
        lens_lag_s=lag_s,
        lens_lag_sigma_s=math.hypot(lag_s * lag_sigma, TIME_FLOOR_S),
    )


def _moments(values: Array, weights: Array) -> tuple[float, float]:
    mean = float((weights * values).sum() / weights.sum())
    return mean, math.sqrt(float((weights * (values - mean) ** 2).sum() / weights.sum()))


# --- the calibration file ---
# A calibration file that is made of parts: one table of it is measured anew, what it said before is kept beside it.

TABLES = ("focus", "camera")


def check_file(path: Path) -> dict[str, Any]:
    """What the file says now, nothing where it is yet to be made. Raises ConfigError for a file that is no calibration:
    another file of the user's is not to get a table of ours."""
    if path.suffix != ".toml":
        raise ConfigError(f"{path}: give --out a name that ends in .toml")
    if not path.exists():
        return {}
    content = read_toml(path)
    if "robot" not in content or not any(isinstance(content.get(table), dict) for table in TABLES):
        raise ConfigError(f"{path}: is no calibration file; give --out a new name, or that of a calibration")
    return content


def put(path: Path, table: str, fields: dict[str, Any], source: Path) -> str:
    """Write one table of a calibration file and keep its others; says what became of what was there.

    The file as it was is kept beside it, by a name that nothing had. `source`: what was measured.
    """
    before, today = check_file(path), datetime.now(UTC).strftime("%Y-%m-%d")
    content = {"robot": path.stem, "made": today, "source": "", **before}
    content["source"] = "; ".join(filter(None, (content["source"], f"[{table}] on {today} from {source}")))
    content[table] = fields
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = free_name(path.with_name(path.name + ".before"))
    if before:
        shutil.copy2(path, kept)
    write_whole(path, tomli_w.dumps(content))
    if not before:
        said = f"[{table}] written to {path}, the calibration of robot '{content['robot']}'"
    else:
        said = f"[{table}] of {path} {'replaced' if table in before else 'added'}; the file as it was: {kept}"
    missing = [each for each in TABLES if each not in content]
    return said + "".join(f"\n[{each}] is missing; a robot needs it: aucamp calibrate {each}" for each in missing)


# --- the table of ranges ---

REQUIRED = ("u_mm", "code")
OPTIONAL = (
    *("camera", "direction", "repeat", "score", "width", "tilt_deg", "temp_c", "medium", "sweep_id"),
    *("x_px", "y_px", "picture_code"),
)
LEVEL_DEG = 3.0  # a lens that looks up or down by less sags by 0.3 lens positions, within the noise of a peak
GOOD_LEFT_OUT = 0.05  # share of the range: a distance that the others foretell worse is named in the verdict
MOST_SHARE = 0.1  # of a range, as the standard deviation of the curve: beyond it a range is a guess
MOST_APART = 0.2  # of a range, between the curve and the one that it replaces


class PaperGauge(NamedTuple):
    """The same curve as the paper prints it: h = f k rho / (k rho - f) + c, lengths in metres."""

    k: float
    f_m: float
    c_m: float


def run(table: Path, out: Path | None, console: Console) -> FocusFit:
    """Fit, print, plot beside the table, and put the fit into `out` if given. Raises ConfigError, one line."""
    before = {} if out is None else check_file(out)
    rows, tilted, places = read_table(table)
    try:
        field = None
        if places:
            rows, field = without_field(rows, places, _camera_in(before, table))
        fit, left_out = with_sag(replace(fit_focus(rows), field=field), tilted), leave_one_out(rows)
    except CalibrationRefused as error:
        raise ConfigError(f"{table}: {error}") from None
    known = [(row.u_m, focus.range_share(fit, row.rho)) for row in rows]
    worst_m, share = max(known, key=lambda one: one[1])
    if not share <= MOST_SHARE:
        raise ConfigError(
            f"{table}: these peaks determine a range of {worst_m:.2f} m to {100 * share:.0f} % only, and "
            f"{100 * MOST_SHARE:.0f} % is needed: measure at more distances, nearer ones among them"
        )
    console.print(result_table(fit, left_out))
    console.print(verdict(fit, left_out))
    with suppress(ConfigError, KeyError):
        u_m, share = focus.apart(fit, convert(before["focus"], FocusFit, table), [row.rho for row in rows])
        if share > MOST_APART:
            said = f"It differs from the curve that it replaces by {100 * share:.0f} % at {u_m:.2f} m"
            console.print(f"{said}; are the columns swapped?")
    picture = free_name(table.with_suffix(".png"))
    figure(rows, fit, left_out).savefig(picture)
    console.print(f"picture: {picture}")
    if out is not None:
        fields = {name: value for name, value in msgspec.to_builtins(fit).items() if value is not None}
        console.print(put(out, "focus", fields, table))
    return fit


def _camera_in(calibration: dict[str, Any], table: Path) -> CameraFit:
    """[camera] of a calibration file, which says where a pixel looks. Raises ConfigError."""
    if "camera" not in calibration:
        raise ConfigError(
            f"{table}: columns x_px and y_px need [camera] in the file of --out; measure it first, by "
            "`aucamp calibrate camera`"
        )
    return convert(calibration["camera"], CameraFit, table)


def without_field(
    rows: Sequence[FocusRow], places: Sequence[Place], camera: CameraFit
) -> tuple[list[FocusRow], FieldFit]:
    """Peaks of places all over the picture as they would be on the axis, and the field. Raises CalibrationRefused."""
    aside = list[Aside]()
    for row, place in zip(rows, places, strict=True):
        at = at_lens_position(camera, place.picture_code)
        u_m = as_on_axis(row.u_m, port_share(at, place.px))
        aside.append(Aside(place.sweep, u_m, on_sensor(at, place.px, row.rho), row.rho, row.sigma))
    plain = [row._replace(u_m=at.u_m, tape_m=row.u_m) for row, at in zip(rows, aside, strict=True)]
    field = fit_field(fit_focus(plain), aside)
    for _ in range(FIELD_PASSES - 1):
        field = fit_field(fit_focus(_on_axis(plain, aside, field)), aside)
    return _on_axis(plain, aside, field), field


def _on_axis(rows: Sequence[FocusRow], aside: Sequence[Aside], field: FieldFit) -> list[FocusRow]:
    """The peaks as they would be on the axis by this field."""
    return [row._replace(rho=row.rho - shift(field, at.on_sensor)) for row, at in zip(rows, aside, strict=True)]


class Place(NamedTuple):
    """Where in which sweep the peak of a row was taken."""

    sweep: int
    px: tuple[float, float]
    picture_code: float  # of the picture in which it is there


class Measured(NamedTuple):
    """The rows of a table: those of a level camera, which the curve is fitted to, and the others."""

    level: list[FocusRow]
    tilted: list[TiltedPeak]
    places: list[Place]  # of those of the level camera; none where the table does not say


def read_table(path: Path) -> Measured:
    """A CSV with at least the columns u_mm and code. Raises ConfigError that names line and column.

    tilt_deg: how far the camera looked up; u_mm is then counted along its axis.
    """
    names, numbered = read_rows(path)
    lines = [line for _, line in numbered]
    if not lines:
        raise ConfigError(f"{path}: no rows; write one line per peak under the header {','.join(REQUIRED)}")
    header = set(names)
    for column in sorted(header - set(REQUIRED) - set(OPTIONAL)):
        raise ConfigError(f"{path}: unknown column '{column}'; known are {', '.join((*REQUIRED, *OPTIONAL))}")
    for column in set(REQUIRED) - header:
        raise ConfigError(f"{path}: column '{column}' is missing; add it")
    for column in ("direction", "camera", "medium"):
        if len(values := sorted({line.get(column) or "" for line in lines})) > 1:
            raise ConfigError(f"{path}: column '{column}' mixes {', '.join(values)}; fit each by itself")
    if ("x_px" in header) != ("y_px" in header):
        raise ConfigError(f"{path}: columns x_px and y_px belong together; give both or none")
    sweeps = sorted({line.get("sweep_id") or "" for line in lines})
    rows, tilted, places = list[FocusRow](), list[TiltedPeak](), list[Place]()
    for number, line in numbered:
        u_mm, code = (_number(path, number, column, line[column]) for column in REQUIRED)
        if u_mm <= 0:
            raise ConfigError(f"{path}: line {number}: u_mm is {u_mm:g}; a range is positive")
        tilt_deg = _number(path, number, "tilt_deg", line["tilt_deg"]) if line.get("tilt_deg") else 0.0
        if abs(tilt_deg) > 90.0:
            raise ConfigError(f"{path}: line {number}: tilt_deg is {tilt_deg:g}; straight up is 90")
        if abs(tilt_deg) > LEVEL_DEG:
            tilted.append(TiltedPeak(u_mm * 1e-3, code, math.radians(tilt_deg)))
            continue
        width = _number(path, number, "width", line["width"]) if line.get("width") else math.nan
        if width <= 0:
            raise ConfigError(f"{path}: line {number}: width is {width:g}; a half width is positive")
        rows.append(FocusRow(u_mm * 1e-3, code, width))
        if "x_px" in header:
            x, y = (_number(path, number, column, line[column]) for column in ("x_px", "y_px"))
            seen_at = _number(path, number, "picture_code", line["picture_code"]) if line.get("picture_code") else code
            places.append(Place(sweeps.index(line.get("sweep_id") or ""), (x, y), seen_at))
    _check_ranges(path, [row.u_m for row in rows])
    known = [row.width for row in rows if math.isfinite(row.width)]
    rho = [row.rho for row in rows] or [0.0]
    typical = float(np.median(known)) if known else 0.1 * (max(rho) - min(rho))
    rows = [row if math.isfinite(row.width) else row._replace(width=typical) for row in rows]
    return Measured(rows, tilted, places)


NEAR_M, FAR_M = 0.15, 20.0  # the farthest board is farther than this, and no board is farther than that
UNITS = {"metres": 1e3, "inches": 25.4, "centimetres": 10.0}  # in mm, that are taken for them


def _check_ranges(path: Path, ranges_m: Sequence[float]) -> None:
    """Raises ConfigError for distances that no board stands at, with the unit that they may be in."""
    if not ranges_m or NEAR_M <= max(ranges_m) <= FAR_M:
        return
    low, high = min(ranges_m), max(ranges_m)
    fits = [unit for unit, mm in UNITS.items() if NEAR_M <= high * mm <= 5.0 and low * mm >= 0.05]
    likely = f"is u_mm in {' or '.join(fits)}?" if fits else "u_mm is in millimetres;"
    raise ConfigError(f"{path}: {low:.2g} to {high:.2g} m are no distances of a board; {likely} correct the column")


def paper_gauge(fit: FocusFit) -> PaperGauge:
    """k, f, c with v = k rho: a choice of zero that the measurements do not fix, for comparison with the paper only."""
    f_m = fit.b_m / fit.rho0
    return PaperGauge(f_m / fit.rho0, f_m, fit.u_inf_m - f_m)


def badly_foretold(left_out: Sequence[LeftOut]) -> list[LeftOut]:
    """The distances that the others foretell too badly for the fit to be good."""
    return [one for one in left_out if one.error_m > GOOD_LEFT_OUT * one.u_m]


def verdict(fit: FocusFit, left_out: Sequence[LeftOut]) -> str:
    """Good or not, and what to do, in one or two sentences."""
    bad = badly_foretold(left_out)
    reach = f"{left_out[0].u_m:.2f} to {left_out[-1].u_m:.2f} m"
    if not bad:
        few = f" But {len(left_out)} hardly tell how sure that is: measure at {SURE_DISTANCES} or more."
        good = f"Good from {reach}: every distance is foretold by the others to {100 * GOOD_LEFT_OUT:.0f} %."
        return good + (few if len(left_out) < SURE_DISTANCES else "")
    places = ", ".join(f"{one.u_m:.2f} m ({1e3 * one.error_m:.0f} mm)" for one in bad)
    return f"Doubtful: leaving a distance out misses it at {places}. Measure there again, or add distances around."


def result_table(fit: FocusFit, left_out: Sequence[LeftOut]) -> Table:
    """The curve in both gauges, its worth, and the error at each distance that is left out."""
    table = Table(title="h(rho) = u_inf + b / (rho - rho0)")
    table.add_column("what")
    table.add_column("value", justify="right")
    paper = paper_gauge(fit)
    sigma = [math.sqrt(max(fit.covariance[i], 0.0)) for i in (0, 3, 5)]
    worst = max(focus.range_share(fit, rho) for rho in (fit.lowest, fit.highest))
    sag = "not measured" if fit.sag_sigma is None else f"{fit.sag:.3g} ± {fit.sag_sigma:.2g}"
    for what, value in (
        ("u_inf, m", f"{fit.u_inf_m:.5g} ± {sigma[0]:.2g}"),
        ("b, m", f"{fit.b_m:.5g} ± {sigma[1]:.2g}"),
        ("rho0", f"{fit.rho0:.6g} ± {sigma[2]:.2g}"),
        ("range by the curve, at most", f"± {100 * worst:.1f} %"),
        ("one peak, lens positions", f"± {fit.noise:.3g}"),
        ("sag looking straight up, lens positions", sag),
        ("k, f (m), c (m) as in the paper", f"{paper.k:.4g}, {paper.f_m:.4g}, {paper.c_m:.4g}"),
        ("R²", f"{fit.r2:.4f}"),
        ("RMSE, mm", f"{1e3 * fit.rmse_m:.2f}"),
        ("RMSE of distances left out, mm", f"{1e3 * fit.held_out_rmse_m:.2f}"),
    ):
        table.add_row(what, value)
    for one in left_out:
        table.add_row(f"left out: {one.u_m:.3f} m", f"{1e3 * one.error_m:.1f} mm")
    return table


def figure(rows: Sequence[FocusRow], fit: FocusFit, left_out: Sequence[LeftOut]) -> Figure:
    """Measurements and curve above, errors below."""
    from matplotlib.figure import Figure

    u, rho = np.array([r.u_m for r in rows]), np.array([r.rho for r in rows])
    ranges = np.linspace(u.min(), u.max(), 300)
    drawn = Figure(figsize=(6, 6), layout="tight")
    above, below = drawn.subplots(2, 1, height_ratios=(2, 1))
    above.plot(fit.rho0 + fit.b_m / (ranges - fit.u_inf_m), ranges, label="h(rho)")
    above.plot(rho, u, ".", label="measured")
    above.set(xlabel="lens position", ylabel="range, m", title=f"R² {fit.r2:.4f}, RMSE {1e3 * fit.rmse_m:.1f} mm")
    above.legend()
    below.plot(u, 1e3 * (fit.u_inf_m + fit.b_m / (rho - fit.rho0) - u), ".", label="residual")
    below.plot([o.u_m for o in left_out], [1e3 * o.error_m for o in left_out], "x", label="left out, rms")
    below.axhline(0.0, color="grey", linewidth=0.7)
    below.set(xlabel="range, m", ylabel="mm")
    below.legend()
    return drawn


def _number(path: Path, line: int, column: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{path}: line {line}, column '{column}': '{text}' is no number")
    return value
