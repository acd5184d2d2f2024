"""The table of errors: what priors and posteriors missed the truth by, axis by axis, and whether they knew it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from agent.kernel.messages import Vector
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
    within_2_sigma: float | None  # share, by the covariance that the robot stated; None: it stated none


def error_table(timelines: Sequence[RobotTimeline], truth_m: Vector) -> list[ErrorRow]:
    """Priors over the whole run, posteriors over the last LATE iterations."""
    rows = []
    for timeline in timelines:
        priors = np.array([x for _, x in timeline.priors]).reshape(-1, 3) - truth_m
        if len(priors):
            rows += _rows(timeline.label, "prior", 1e3 * priors, None)
        late = [belief for belief in timeline.beliefs if belief.state.posterior_m is not None][-LATE:]
        if late:
            errors = np.array([belief.state.posterior_m for belief in late]) - truth_m
            covariances = [belief.cov_m2 for belief in late]
            sigmas = np.array([[math.sqrt(c[k]) for k in VARIANCES] if c else [math.nan] * 3 for c in covariances])
            rows += _rows(timeline.label, "posterior", 1e3 * errors, 1e3 * sigmas)
    return rows


def _rows(robot: str, what: str, errors: Array, sigmas: Array | None) -> list[ErrorRow]:
    """errors (n, 3) and their standard deviations (n, 3) or None, mm -> rows for the axes and for the length."""
    found = []
    for k, axis in enumerate(AXES):
        known = None if sigmas is None else np.isfinite(sigmas[:, k])
        share = None
        if sigmas is not None and known is not None and known.any():
            share = float(np.mean(np.abs(errors[known, k]) <= 2.0 * sigmas[known, k]))
        found.append(_row(robot, what, axis, errors[:, k], float(errors[:, k].mean()), share))
    return [*found, _row(robot, what, "3-D", np.linalg.norm(errors, axis=1), None, None)]


def _row(robot: str, what: str, axis: str, e: Array, bias: float | None, share: float | None) -> ErrorRow:
    size = np.abs(e)
    rmse, p95 = math.sqrt(float((e * e).mean())), float(np.percentile(size, 95))
    return ErrorRow(robot, what, axis, len(e), bias, rmse, p95, float(size.max()), share)


def relative_percent(estimate_m: Vector, truth_m: Vector, from_m: Vector = (0.0, 0.0, 0.0)) -> float:
    """|x - x*| over the target's distance from a place: the tank's corner as in the paper, or a robot's camera."""
    return 100.0 * math.dist(estimate_m, truth_m) / math.dist(from_m, truth_m)
