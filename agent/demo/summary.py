"""What a run was worth: errors of priors and posteriors against the truth, which only the twin knows.

A run has a history for each target and robot. The verdict is over all of them.

Of a ball the middle is measured, to the paper's figure. Of a thing in a box each robot measures a point of the surface
that it sees, and what several of them agree on lies between such points: on the thing or in it. How far outside of it
an estimate lies is what counts, beside the standard deviation that the robot itself states.

Of what swims there is a track instead of a place (following.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from agent.core.config import Fleet
from agent.core.messages import State, Vector
from agent.demo import following
from agent.demo.coverage import SurveyWatch
from agent.demo.history import Histories, History

PASS_PERCENT = 0.4  # the paper's final relative error (section 6)
SIGMAS = 3.0  # how many of its own standard deviations an estimate may lie outside of a thing in a box


def summarize(
    fleet: Fleet,
    histories: Histories,
    truth: dict[str, Any],
    wall_s: float,
    followed: Mapping[str, dict[str, Any]] | None = None,
    survey: SurveyWatch | None = None,
) -> dict[str, Any]:
    """The content of summary.json, schema 1. `truth`: as the twin wrote it; `followed`: following.scored of each target
    that swims.

    `targets` has every target; `truth_m` and `agents` are those of the first. survey: of a fleet with [coverage], whose
    verdict is over what it surveyed, for its cameras are at that and not at targets.
    """
    targets: dict[str, Any] = {}
    why = []
    for target, of_target in histories.items():
        if followed is not None and target in followed:
            targets[target] = followed[target]
            found = following.reasons_following(followed[target])
            why += [f"{target}: {reason}" if len(histories) > 1 else reason for reason in found]
            continue
        truth_m: Vector = tuple(truth["target_m"][target])
        radii_m: Vector | None = tuple(truth["target_radii_m"][target]) if is_box(fleet, target) else None
        rows = {name: score(history, truth_m, radii_m) for name, history in of_target.items()}
        targets[target] = {"truth_m": list(truth_m), "radii_m": radii_m, "agents": rows}
        why += [f"{target}: {reason}" if len(histories) > 1 else reason for reason in reasons(rows)]
    if survey is not None:
        why = list(survey.reasons())
    first, depth_m = next(iter(targets)), next(iter(fleet.robot.values())).depth_m
    return {
        "schema": 1,
        "protocol": fleet.estimation.protocol,
        "seed": fleet.twin.seed,
        "loss": fleet.link.loss,
        "wall_s": round(wall_s, 1),
        "truth_m": targets[first]["truth_m"],
        "agents": targets[first]["agents"],
        "targets": targets,
        "control": control(histories[first].values(), depth_m),
        **({} if survey is None else {"coverage": survey.as_json()}),
        "verdict": "fail" if why else "pass",
        "reasons": why,
    }


def is_box(fleet: Fleet, target: str) -> bool:
    """Whether it is a thing in a box, which need not look like its picture from everywhere."""
    return fleet.target[target].detector == "box"


def settled(histories: Iterable[History], after_views: int, window: int, within_m: float, all_see: bool = True) -> bool:
    """All see the target, or without `all_see` have an estimate; `after_views` iterations have passed since the last of
    them first did, and no posterior moved further than `within_m` over the last `window` iterations. Knows nothing of
    the truth."""
    lasts = [h.iterations() for h in histories]
    began = [acquired(states) if all_see else first_estimate(states) for states in lasts]
    if any(t is None for t in began):
        return False
    last_view = max(t or 0 for t in began)
    return all(states[-1].t >= last_view + after_views and moved_m(states[-window:]) <= within_m for states in lasts)


def acquired(states: Sequence[State]) -> int | None:
    """The iteration at which it first saw the target."""
    return states[-1].acquired_t if states else None


def first_estimate(states: Sequence[State]) -> int | None:
    """The iteration at which it first knew where the target is, by its own eyes or a neighbour's word."""
    return next((state.t for state in states if state.posterior_m is not None), None)


def moved_m(states: Sequence[State]) -> float:
    """Largest distance of a posterior from the last one."""
    places = [s.posterior_m for s in states if s.posterior_m is not None]
    return max((distance_m(p, places[-1]) for p in places), default=math.inf)


def score(history: History, truth: Vector, radii_m: Vector | None = None) -> dict[str, Any]:
    """One robot's row of summary.json; lengths in metres unless the name says otherwise.

    `radii_m`: along x, y and z, of a thing in a box, whose middle is `truth`; None: a ball.
    """
    newest = history.newest
    estimate = newest.posterior_m if newest else None
    priors = history.priors()
    error_mm = distance_m(estimate, truth) * 1e3 if estimate else None
    sigma_m = newest.posterior_sigma_m if newest else None
    percent = 100.0 * error_mm * 1e-3 / distance_m((0, 0, 0), truth) if error_mm is not None else None
    of_a_box: dict[str, float | None] = {"outside_mm": None, "allowed_mm": None}
    if radii_m is not None and estimate is not None:
        of_a_box["outside_mm"] = 1e3 * outside_m(estimate, truth, radii_m)
        of_a_box["allowed_mm"] = 1e3 * min(SIGMAS * (sigma_m or 0.0), max(radii_m))  # who knows nothing is not right
    return {
        "estimate_m": estimate,
        "sigma_m": sigma_m,
        "error_mm": error_mm,
        "error_axis_mm": [(e - x) * 1e3 for e, x in zip(estimate, truth, strict=True)] if estimate else None,
        "relative_error_percent": percent if radii_m is None else None,
        "acquired_iteration": newest.acquired_t if newest else None,
        "iterations": newest.t if newest else 0,
        "measurements": newest.measurements if newest else 0,
        "prior_rmse_mm": rms(distance_m(p, truth) for p in priors) * 1e3 if priors else None,
        "prior_rmse_axis_mm": [rms(p[k] - truth[k] for p in priors) * 1e3 for k in range(3)] if priors else None,
        "below_0_4_percent_from": first_below(history, truth) if radii_m is None else None,
        **(of_a_box if radii_m is not None else {}),
    }


def outside_m(place: Vector, middle: Vector, radii_m: Vector) -> float:
    """How far a place lies outside of an ellipsoid, measured towards its middle: no less than the shortest way."""
    offset = [p - x for p, x in zip(place, middle, strict=True)]
    radii_away = math.hypot(*(d / r for d, r in zip(offset, radii_m, strict=True)))
    return math.hypot(*offset) * (1.0 - 1.0 / radii_away) if radii_away > 1.0 else 0.0


def first_below(history: History, truth: Vector) -> int | None:
    """The iteration from which on the relative error stayed below the paper's figure; None if it is not."""
    limit_m = PASS_PERCENT / 100.0 * distance_m((0, 0, 0), truth)
    since = None
    for state in history.iterations():
        good = state.posterior_m is not None and distance_m(state.posterior_m, truth) < limit_m
        if not good:
            since = None
        elif since is None:
            since = state.t
    return since


def control(histories: Iterable[History], depth_m: float) -> dict[str, float | None]:
    """How still the armed robots hung, by their own pressure sensors."""
    armed = [s for h in histories for s in h.states if s.armed and s.depth_m is not None]
    tilts = [math.hypot(s.roll_deg or 0.0, s.pitch_deg or 0.0) for s in armed]
    return {
        "depth_rms_mm": rms((s.depth_m or 0.0) - depth_m for s in armed) * 1e3 if armed else None,
        "tilt_rms_deg": rms(tilts) if armed else None,
    }


def reasons(rows: dict[str, dict[str, Any]]) -> list[str]:
    """Why the run failed; empty when every robot's estimate is as good as it has to be."""
    found = []
    for robot, row in rows.items():
        is_box = "outside_mm" in row
        if row["error_mm"] is None:
            found.append(f"{robot} has no estimate")
        elif is_box and row["outside_mm"] > row["allowed_mm"]:
            found.append(f"{robot}: {row['outside_mm']:.1f} mm outside of it > {row['allowed_mm']:.1f} mm")
        elif not is_box and row["relative_error_percent"] >= PASS_PERCENT:
            found.append(f"{robot}: relative error {row['relative_error_percent']:.2f} % >= {PASS_PERCENT} %")
        if row["acquired_iteration"] is None and not is_box:  # others tell it where a thing is that it cannot see
            found.append(f"{robot} never saw the target")
    return found


def distance_m(a: Vector, b: Vector) -> float:
    """Euclidean."""
    return math.dist(a, b)


def rms(values: Iterable[float]) -> float:
    """Root mean square; not a number of nothing."""
    squares = [v * v for v in values]
    return math.sqrt(math.fsum(squares) / len(squares)) if squares else math.nan
