"""`aucamp calibrate focus`: a table of (range, sharpest lens position) -> h(rho), its worth, and a verdict in words."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.table import Table

from agent.core.config import ConfigError
from agent.core.messages import Symmetric
from agent.core.ranging.camera_model import FocusFit
from agent.core.ranging.focus import TiltedPeak, with_sag
from agent.process.command import free_name
from agent.tools.calibration_file import check_file, put
from agent.tools.fit import CalibrationRefused, FocusRow, LeftOut, fit_focus, leave_one_out

REQUIRED = ("u_mm", "code")
OPTIONAL = ("camera", "direction", "repeat", "score", "width", "tilt_deg", "temp_c", "medium", "sweep_id")
LEVEL_DEG = 3.0  # a lens that looks up or down by less sags by 0.3 lens positions, within the noise of a peak
GOOD_LEFT_OUT = 0.05  # share of the range: a distance that the others foretell worse is named in the verdict


class PaperGauge(NamedTuple):
    """The same curve as the paper prints it: h = f k rho / (k rho - f) + c, lengths in metres."""

    k: float
    f_m: float
    c_m: float


def run(table: Path, out: Path | None, console: Console) -> FocusFit:
    """Fit, print, plot beside the table, and put the fit into `out` if given. Raises ConfigError, one line."""
    rows, tilted = read_table(table)
    try:
        fit, left_out = with_sag(fit_focus(rows), tilted), leave_one_out(rows)
    except CalibrationRefused as error:
        raise ConfigError(f"{table}: {error}") from None
    if out is not None:
        check_file(out)
    console.print(result_table(fit, left_out))
    console.print(verdict(fit, left_out))
    picture = free_name(table.with_suffix(".png"))
    figure(rows, fit, left_out).savefig(picture)
    console.print(f"picture: {picture}")
    if out is not None:
        console.print(put(out, "focus", _fields(fit), table))
    return fit


class Measured(NamedTuple):
    """The rows of a table: those of a level camera, which the curve is fitted to, and the others."""

    level: list[FocusRow]
    tilted: list[TiltedPeak]


def read_table(path: Path) -> Measured:
    """A CSV with at least the columns u_mm and code. Raises ConfigError that names line and column.

    tilt_deg: how far the camera looked up; u_mm is then counted along its axis.
    """
    try:
        lines = list(csv.DictReader(path.read_text(encoding="utf-8-sig").splitlines()))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror}); give a CSV file") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: not a CSV file ({error}); save the table as CSV in UTF-8") from None
    if not lines:
        raise ConfigError(f"{path}: no rows; write one line per peak under the header {','.join(REQUIRED)}")
    header = set(lines[0])
    for column in header - set(REQUIRED) - set(OPTIONAL):
        raise ConfigError(f"{path}: unknown column '{column}'; known are {', '.join((*REQUIRED, *OPTIONAL))}")
    for column in set(REQUIRED) - header:
        raise ConfigError(f"{path}: column '{column}' is missing; add it")
    for column in ("direction", "camera", "medium"):
        values = sorted({line.get(column) or "" for line in lines})
        if len(values) > 1:
            raise ConfigError(f"{path}: column '{column}' mixes {', '.join(values)}; fit each by itself")
    rows, tilted = [], []
    for number, line in enumerate(lines, start=2):
        u_mm, code = (_number(path, number, column, line[column]) for column in REQUIRED)
        if u_mm <= 0:
            raise ConfigError(f"{path}: line {number}: u_mm is {u_mm:g}; a range is positive")
        tilt_deg = _number(path, number, "tilt_deg", line["tilt_deg"]) if line.get("tilt_deg") else 0.0
        if abs(tilt_deg) > LEVEL_DEG:
            tilted.append(TiltedPeak(u_mm * 1e-3, code, math.radians(tilt_deg)))
            continue
        width = _number(path, number, "width", line["width"]) if line.get("width") else math.nan
        rows.append(FocusRow(u_mm * 1e-3, code, width))
    known = [row.width for row in rows if math.isfinite(row.width)]
    rho = [row.rho for row in rows] or [0.0]
    typical = float(np.median(known)) if known else 0.1 * (max(rho) - min(rho))
    return Measured([row if math.isfinite(row.width) else row._replace(width=typical) for row in rows], tilted)


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
        return f"Good from {reach}: every distance is foretold by the others to {100 * GOOD_LEFT_OUT:.0f} %."
    places = ", ".join(f"{one.u_m:.2f} m ({1e3 * one.error_m:.0f} mm)" for one in bad)
    return f"Doubtful: leaving a distance out misses it at {places}. Measure there again, or add distances around."


def result_table(fit: FocusFit, left_out: Sequence[LeftOut]) -> Table:
    """The curve in both gauges, its worth, and the error at each distance that is left out."""
    table = Table(title="h(rho) = u_inf + b / (rho - rho0)")
    table.add_column("what")
    table.add_column("value", justify="right")
    paper = paper_gauge(fit)
    sigma = [math.sqrt(max(fit.covariance[i], 0.0)) for i in (0, 3, 5)]
    for what, value in (
        ("u_inf, m", f"{fit.u_inf_m:.5g} ± {sigma[0]:.2g}"),
        ("b, m", f"{fit.b_m:.5g} ± {sigma[1]:.2g}"),
        ("rho0", f"{fit.rho0:.6g} ± {sigma[2]:.2g}"),
        ("one peak, lens positions", f"± {fit.noise:.3g}"),
        (
            "sag looking straight up, lens positions",
            "not measured" if fit.sag_sigma is None else f"{fit.sag:.3g} ± {fit.sag_sigma:.2g}",
        ),
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
    u, rho = np.array([r.u_m for r in rows]), np.array([r.rho for r in rows])
    ranges = np.linspace(u.min(), u.max(), 300)
    drawn = Figure(figsize=(6, 6))
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
    drawn.tight_layout()
    return drawn


def _fields(fit: FocusFit) -> dict[str, Any]:
    covariance: Symmetric = fit.covariance
    known = {name: getattr(fit, name) for name in fit.__struct_fields__ if getattr(fit, name) is not None}
    return known | {"covariance": list(covariance)}


def _number(path: Path, line: int, column: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{path}: line {line}, column '{column}': '{text}' is no number")
    return value
