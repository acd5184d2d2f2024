"""`aucamp calibrate body`: the recording of a trial -> the robot's mass, inertia and drag in its calibration file, from
how it moved under the forces that it asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from agent.capabilities.swim.event_ring import Event
from agent.capabilities.swim.pose_filter import (
    BIAS,
    GAIN,
    RATE_RAD_S,
    Belief,
    Drift,
    Hull,
    Wrench,
    add_rate,
    begin,
    predict,
)
from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import ConfigError
from agent.core.linear_algebra import wrap
from agent.core.ranging.camera_model import BodyFit
from agent.process.command import Failed, Show, with_bar
from agent.tools.focus_calibration import CalibrationRefused, check_file, put
from replay.check.reexecute import BlackBox, open_box, take

# --- the fit ---
# A robot's mass, inertia and drag from how it moved under the forces that it asked for.
#
# Prediction error method (Ljung, "System Identification", 1999, chapter 7): the pose filter runs over the trial with
# the constants that are sought, and they are those whose predictions of the next fix are missed least. So the
# tether's pull and the water's gusts, which the filter follows, are not taken for drag.

Array = NDArray[np.float64]

# Of the logarithm of each: half or twice as large is one standard deviation away; lags of thrusters differ by a fifth.
PRIOR = np.array([0.7] * 6 + [0.2])
# What disturbs a robot that is calibrated: a tether's pull of 0.05 N that forgets itself in 4 s, and no more.
QUIET = Drift(speed=0.005, rate=0.02, push=0.006, twist=0.02, doubt_s=0.0)
MIN_FIXES = 60
MIN_COAST_S = 5.0  # of moving without force, altogether
HUBER = 2.5  # standard deviations, beyond which a fix pulls with constant force
PASSES, STEP, MOST, ENOUGH = 15, 0.02, 0.7, 0.005  # of the search; in logarithms
WELL_KNOWN = 0.35  # relative standard deviation of what has been learnt
# One mass stands for both directions, but the water that moves along is another ahead than to the side: on the twin's
# bodies that is 3 % (rms) of it. The trial's own noise is 1 %.
ONE_MASS = 0.03


class Trial(NamedTuple):
    """A stretch of a recording."""

    events: tuple[Event, ...]  # forces asked for, fixes and rates, by time
    gyro: bool


def fit_body(trial: Trial, progress: Callable[[], None] = lambda: None) -> BodyFit:
    """The constants of the robot that swam it. Raises CalibrationRefused where it says too little of them."""
    fixes = _check(trial)

    def residuals(log_ratio: Array) -> Array:
        progress()
        return whitened(hull(log_ratio), trial)

    log_ratio, normal, missed = _gauss_newton(residuals)
    misfit = math.sqrt(float((missed * missed).mean()))
    C = np.linalg.inv(normal) * max(misfit, 1.0) ** 2
    sigma = np.minimum(np.sqrt(np.diag(C)), PRIOR)
    sigma[0] = math.hypot(sigma[0], ONE_MASS)
    told = hull(log_ratio)
    if max(sigma[0], sigma[3]) > WELL_KNOWN:
        raise CalibrationRefused(
            f"the trial leaves mass known to {100 * sigma[0]:.0f} % and inertia to {100 * sigma[3]:.0f} %; "
            "show more landmarks to the camera, and swim it again"
        )
    names = ("mass_kg", "drag", "drag2", "inertia_kgm2", "turn_drag", "turn_drag2", "lag_s")
    values = {name: float(getattr(told, name)) for name in names}
    relative = tuple(float(s) for s in sigma)
    return BodyFit(**values, sigma=relative, misfit=misfit, fixes=fixes)  # type: ignore[arg-type]


def hull(log_ratio: Array) -> Hull:
    """Constants so many times those of a robot like others."""
    return Hull(*(value * math.exp(x) for value, x in zip(Hull(), log_ratio, strict=True)))


def _gauss_newton(residuals: Callable[[Array], Array]) -> tuple[Array, Array, Array]:
    """Logarithms of the ratios, normal matrix and residuals where Huber's loss and the prior are least."""

    def loss(r: Array, p: Array) -> float:
        a = np.abs(r)
        return float(np.where(a <= HUBER, r * r, HUBER * (2.0 * a - HUBER)).sum() + ((p / PRIOR) ** 2).sum())

    p = np.zeros(len(PRIOR))
    r = residuals(p)
    for _ in range(PASSES):
        J = np.column_stack([(residuals(p + STEP * e) - r) / STEP for e in np.eye(len(p))])
        weights = np.minimum(1.0, HUBER / np.maximum(np.abs(r), 1e-12))
        normal = (J.T * weights) @ J + np.diag(PRIOR**-2.0)
        step = -np.linalg.solve(normal, J.T @ (weights * r) + p / PRIOR**2)
        step *= min(1.0, MOST / float(np.abs(step).max()))
        before = loss(r, p)
        while (after := loss(fresh := residuals(p + step), p + step)) > before and np.abs(step).max() > ENOUGH:
            step = 0.5 * step
        if after > before:
            break
        p, r = p + step, fresh
        if np.abs(step).max() <= ENOUGH:
            break
    return p, normal, r


def whitened(of: Hull, trial: Trial) -> Array:
    """By how much each fix, and each rate, was missed by what was predicted, in standard deviations: independent
    numbers of variance 1 where constants and noise are the true ones."""
    events = trial.events
    first = next(i for i, event in enumerate(events) if event.kind == "2 fix")
    pose, _ = _fix(events[first])
    before = [_wrench(event) for event in events[:first] if event.kind == "1 asked"]
    acting = before[-1] if before else (0.0, 0.0, 0.0)
    belief = begin(events[first].t_ns, pose, _six(events[first]), gyro=trial.gyro)
    belief = _gain_known(belief)._replace(asked=acting, force=acting)
    out: list[float] = []
    for event in events[first + 1 :]:
        belief = predict(belief, of, QUIET, event.t_ns)
        if event.kind == "1 asked":
            belief = belief._replace(asked=_wrench(event))
        elif event.kind == "2 fix":
            belief, missed = _corrected(belief, event)
            out += missed
        elif event.kind == "5 rate" and trial.gyro:
            sigma = math.sqrt(belief.P[5][5] + 2.0 * belief.P[5][BIAS] + belief.P[BIAS][BIAS] + RATE_RAD_S * RATE_RAD_S)
            out.append((event.values[0] - belief.x[5] - belief.x[BIAS]) / sigma)
            belief = add_rate(belief, event.values[0])
    return np.array(out)


def _gain_known(belief: Belief) -> Belief:
    """One that takes every yaw moment for what was asked: what differs is the inertia's to say."""
    P = np.array(belief.P)
    P[GAIN], P[:, GAIN] = 0.0, 0.0
    return belief._replace(P=tuple(map(tuple, P.tolist())))


def _corrected(belief: Belief, fix: Event) -> tuple[Belief, list[float]]:
    """The belief after a fix, and the three whitened numbers by which that was missed.

    None is refused: with constants that are far off, a filter that refuses fixes loses its way.
    """
    pose, R = _fix(fix)
    P = np.array(belief.P)
    y = np.array([pose[0] - belief.x[0], pose[1] - belief.x[1], wrap(pose[2] - belief.x[2])])
    L = np.linalg.cholesky(P[:3, :3] + R)
    e = np.linalg.solve(L, y)
    G = np.linalg.solve(L, P[:3])  # P H' S^-1 = G' L^-1
    x = np.array(belief.x) + G.T @ e
    x[2] = wrap(x[2])
    P = P - G.T @ G
    return belief._replace(x=tuple(x.tolist()), P=tuple(map(tuple, (0.5 * (P + P.T)).tolist()))), e.tolist()


def _fix(event: Event) -> tuple[tuple[float, float, float], Array]:
    xx, xy, xp, yy, yp, pp = _six(event)
    x, y, psi = event.values[:3]
    return (x, y, psi), np.array([[xx, xy, xp], [xy, yy, yp], [xp, yp, pp]])


def _wrench(event: Event) -> Wrench:
    ahead, left, moment = event.values
    return ahead, left, moment


def _six(event: Event) -> tuple[float, float, float, float, float, float]:
    xx, xy, xp, yy, yp, pp = event.values[3:9]
    return xx, xy, xp, yy, yp, pp


def _check(trial: Trial) -> int:
    """How many fixes there are. Raises CalibrationRefused for a recording of something else."""
    fixes = [event for event in trial.events if event.kind == "2 fix"]
    if len(fixes) < MIN_FIXES:
        raise CalibrationRefused(
            f"{len(fixes)} poses by landmarks; at least {MIN_FIXES} are needed: record a robot with behaviour 'trial'"
        )
    asked = [event for event in trial.events if event.kind == "1 asked"]
    forces = [max(abs(v) for v in event.values[:2]) for event in asked]
    moments = [abs(event.values[2]) for event in asked]
    coasts_s = sum(
        (after.t_ns - event.t_ns) * 1e-9
        for event, after in pairwise(asked)
        if not any(event.values) and after.t_ns > event.t_ns
    )
    if max(forces, default=0.0) < 0.5 or max(moments, default=0.0) < 0.02 or coasts_s < MIN_COAST_S:
        raise CalibrationRefused(
            f"{coasts_s:.0f} s of coasting, and at most {max(forces, default=0.0):.1f} N and "
            f"{max(moments, default=0.0):.2f} N m asked for: that is no trial; record one with behaviour 'trial'"
        )
    return len(fixes)


# --- `aucamp calibrate body` ---

LARGEST_MISFIT = 2.5  # beyond it the fixes are missed by more than their covariances, and the water's noise, explain
LARGEST_LAG = 3.0  # standard deviations of what thrusters differ by: stamps of time are wrong
ROWS = (
    ("mass_kg", "mass, with the water that moves along", "kg"),
    ("drag", "drag, linear", "N s/m"),
    ("drag2", "drag, quadratic", "N s²/m²"),
    ("inertia_kgm2", "inertia in yaw, likewise", "kg m²"),
    ("turn_drag", "drag in yaw, linear", "N m s"),
    ("turn_drag2", "drag in yaw, quadratic", "N m s²"),
    ("lag_s", "lag of the thrusters", "s"),
)


def run(recording: Path, out: Path | None, console: Console) -> BodyFit:
    """Fit, print, and put the fit into `out` if given. Raises ConfigError and Failed, one line each; CalibrationRefused
    is one, for a fit that does not explain its trial: a robot would fly by it."""
    box = open_box(recording)
    if out is not None and (owner := check_file(out).get("robot", box.robot)) != box.robot:
        raise ConfigError(f"{out}: is the calibration of '{owner}', and {recording} is of '{box.robot}'; give its own")
    trial = with_bar(console, "replaying the trial", lambda show: read_trial(box, show))
    fit = with_bar(console, "fitting", lambda show: _fitted(trial, show))
    console.print(table(fit))
    if why := refusal(fit):
        raise CalibrationRefused(f"{recording}: {why}")
    console.print(explained(fit))
    if out is not None:
        console.print(put(out, "body", msgspec.to_builtins(fit), recording))
    return fit


def read_trial(box: BlackBox, show: Show = lambda done, total, what="": None) -> Trial:
    """What told the robot of its motion: its own agent is run again over what it was given, by today's code."""
    if box.fleet.navigation is None:
        raise Failed(f"{box.path}: '{box.robot}' was moored; record a robot that swims, with behaviour 'trial'")
    agent, events = box.agent(), dict[Event, None]()
    swimmer = swimmer_of(agent.capabilities)
    assert swimmer is not None  # the fleet swims
    for step in box.steps():
        take(agent, step)
        events.update(dict.fromkeys(swimmer.localizer.events))
        if step.number % 200 == 0:
            show(step.number, box.recorded)
    return Trial(tuple(sorted(events)), box.fleet.navigation.gyro)


def _fitted(trial: Trial, show: Show) -> BodyFit:
    """The search ends when it has converged, mostly in a third of its passes."""
    done, most = 0, PASSES * (len(PRIOR) + 1)

    def progress() -> None:
        nonlocal done
        done += 1
        show(min(done, most), most)

    return fit_body(trial, progress)


def table(fit: BodyFit) -> Table:
    """The constants beside those of a robot like others, for people."""
    shown = Table()
    shown.add_column("for each newton asked for")
    for column in ("found", "±", "before", "unit"):
        shown.add_column(column, justify="right")
    for (name, text, unit), sigma, usual, prior in zip(ROWS, fit.sigma, Hull(), PRIOR, strict=True):
        value = getattr(fit, name)
        known = f"{100.0 * sigma:.0f} %" if sigma < 0.9 * prior else "not seen"
        shown.add_row(text, f"{value:.3g}", known, f"{usual:.3g}", unit)
    return shown


def explained(fit: BodyFit) -> str:
    """One line: how well the constants explain the trial."""
    return (
        f"{fit.fixes} poses are missed by {fit.misfit:.2f} times what their covariances and the water's noise explain"
    )


def refusal(fit: BodyFit) -> str:
    """Why nothing is to be believed of the fit; empty: it explains the trial."""
    if fit.misfit > LARGEST_MISFIT:
        return (
            f"{explained(fit)}: something else pushed the robot, or one of T5-T8 is dead or turns the wrong way; look "
            "for a tether that pulled and a current, see which way each thruster pushes, and swim it again"
        )
    usual = Hull().lag_s
    if abs(math.log(fit.lag_s / usual)) > LARGEST_LAG * PRIOR[-1]:
        return (
            f"thrusters seem to answer after {fit.lag_s:.2f} s, and {usual:.2f} s is usual: frames are stamped late, "
            "or a clock was set meanwhile; `aucamp calibrate run` measures [timing], and swim it again"
        )
    return ""
