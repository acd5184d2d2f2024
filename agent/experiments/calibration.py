"""Range against the sharpest lens position: the paper's fit of h(rho), on the twin's bench."""

from __future__ import annotations

from typing import NamedTuple

import msgspec
from rich.console import Group

from agent.core.ranging.camera_model import FocusFit
from agent.experiments.experiment import ExperimentResult, Figures, Row
from agent.process.command import Progress, shipped_fleet
from agent.robot.fleet_reader import load_fleet
from agent.tools.bench_calibration import focus_rows, twin_bench
from agent.tools.focus_calibration import (
    FocusRow,
    LeftOut,
    badly_foretold,
    figure,
    fit_focus,
    leave_one_out,
    paper_gauge,
    result_table,
    verdict,
)

ROBOT = "r1"


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # of the world whose lens is calibrated


class Fitted(NamedTuple):
    """The measurements and the curve through them."""

    rows: list[FocusRow]
    fit: FocusFit
    left_out: list[LeftOut]


class Result(ExperimentResult, frozen=True, kw_only=True):
    """The fit in the paper's gauge; lengths and errors in metres."""

    seed: int
    k: float
    f: float
    c: float
    r2: float
    rmse: float
    leave_one_out: list[Row]
    measured: list[Row]
    shown: Fitted

    @property
    def failed(self) -> bool:
        return bool(badly_foretold(self.shown.left_out))


def run(settings: Settings, progress: Progress) -> Result:
    """Calibrate the lens of one robot; progress counts distances of the board."""
    fleet = load_fleet(shipped_fleet())
    fleet = msgspec.structs.replace(fleet, twin=msgspec.structs.replace(fleet.twin, seed=settings.seed))
    with twin_bench(fleet, ROBOT) as (camera, place):
        rows = focus_rows(fleet, camera, place, progress)
    fit, left_out = fit_focus(rows), leave_one_out(rows)
    paper = paper_gauge(fit)
    return Result(
        seed=settings.seed,
        k=paper.k,
        f=paper.f_m,
        c=paper.c_m,
        r2=fit.r2,
        rmse=fit.rmse_m,
        leave_one_out=[{"distance": one.u_m, "error": one.error_m} for one in left_out],
        measured=[{"distance": row.u_m, "position": row.rho} for row in rows],
        shown=Fitted(rows, fit, left_out),
    )


def table(result: Result) -> Group:
    """The fitted curve, how good it is, and a verdict in words, as `aucamp calibrate focus` prints them."""
    _, fit, left_out = result.shown
    return Group(result_table(fit, left_out), verdict(fit, left_out))


def figures(result: Result) -> Figures:
    """One figure of measurements, curve and errors, as `aucamp calibrate focus` draws it."""
    yield "calibration.png", figure(*result.shown)
