"""The table of errors: what priors and posteriors missed the truth by, axis by axis, and whether they knew it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.core.messages import Symmetric, Vector
from replay.report.figures_belief import VARIANCES
from replay.report.robot_timeline import Array, RobotTimeline

LATE = 10  # iterations at the end over which the posterior is judged
AXES = ("x", "y", "z")


class ErrorRow(NamedTuple):
    """Errors of one robot and target along one axis, or in space ("3-D", without a sign), in mm."""

    robot: str
    what: str  # prior, or posterior
    axis: str
    n: int
    bias: float | None
    rmse: float
    p95: float  # of the absolute error
    largest: float
    within_2_sigma: float | None  # share, by what the robot stated of that axis, or of space; None: it stated nothing


def error_table(timelines: Sequence[RobotTimeline], truth_m: Vector) -> list[ErrorRow]:
    """Priors over the whole run, posteriors over the last LATE iterations."""
    rows = []
    for timeline in timelines:
        if measured := [state for _, state in timeline.measured]:
            priors = np.array([state.prior_m for state in measured]) - truth_m
            stated = [[math.nan, math.nan, math.nan, _finite_mm(state.prior_sigma_m)] for state in measured]
            rows += _rows(timeline.label, "prior", 1e3 * priors, np.array(stated))
        late = [belief for belief in timeline.beliefs if belief.state.posterior_m is not None][-LATE:]
        if late:
            errors = np.array([belief.state.posterior_m for belief in late]) - truth_m
            stated = [[*_axes_mm(belief.cov_m2), _finite_mm(belief.state.posterior_sigma_m)] for belief in late]
            rows += _rows(timeline.label, "posterior", 1e3 * errors, np.array(stated))
    return rows


def _axes_mm(cov_m2: Symmetric | None) -> list[float]:
    return [1e3 * math.sqrt(cov_m2[k]) for k in VARIANCES] if cov_m2 else [math.nan] * 3


def _finite_mm(sigma_m: float | None) -> float:
    return math.nan if sigma_m is None else 1e3 * sigma_m


def _rows(robot: str, what: str, errors: Array, sigmas: Array) -> list[ErrorRow]:
    """errors (n, 3), mm, and the standard deviations stated of the axes and of the length (n, 4), mm; NaN: of none."""
    found = [
        _row(robot, what, axis, errors[:, k], float(errors[:, k].mean()), sigmas[:, k]) for k, axis in enumerate(AXES)
    ]
    return [*found, _row(robot, what, "3-D", np.linalg.norm(errors, axis=1), None, sigmas[:, 3])]


def _row(robot: str, what: str, axis: str, e: Array, bias: float | None, sigmas: Array) -> ErrorRow:
    size, known = np.abs(e), np.isfinite(sigmas)
    share = float(np.mean(size[known] <= 2.0 * sigmas[known])) if known.any() else None
    rmse, p95 = math.sqrt(float((e * e).mean())), float(np.percentile(size, 95))
    return ErrorRow(robot, what, axis, len(e), bias, rmse, p95, float(size.max()), share)


def relative_percent(estimate_m: Vector, truth_m: Vector, from_m: Vector = (0.0, 0.0, 0.0)) -> float:
    """|x - x*| over the target's distance from a place: the tank's corner as in the paper, or a robot's camera."""
    return 100.0 * math.dist(estimate_m, truth_m) / math.dist(from_m, truth_m)
