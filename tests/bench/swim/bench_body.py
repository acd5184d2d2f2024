"""Mass, inertia and drag of a robot by a trial against what the twin drew, and a goto with them and without.

The twin's body under the board's own firmware; tags are drawn, not rendered. A seed is a robot and its water.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Behaviour, Fleet, Goto, Pose, Trial
from agent.core.ranging.camera_model import BodyFit
from agent.experiments.claim import Claim, Figure, Row, Rows, Value, rms
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import START_NS, twin_bodies
from agent.experiments.navigation.manoeuvres import settled_s
from agent.experiments.navigation.swimmers import Swimmers
from agent.process.command import Failed
from agent.robot.step import Agent
from agent.tools import body_calibration
from hw.twin.physics.forces import RING_M, RING_RAD

FIND_S, TRIAL_S, GOTO_S = 12.0, 200.0, 14.0  # at most
SPEED_M_S, RATE_RAD_S = 0.2, 0.6  # at which drags are compared: two that share it are told apart badly
MIDDLE = Pose(x_m=1.5, y_m=1.0, yaw_deg=0.0)
FROM, TO = Pose(x_m=1.25, y_m=1.0, yaw_deg=0.0), Goto(x_m=1.75, y_m=1.0, yaw_deg=0.0)
NEAR_M = 0.02
CONSTANTS = {"mass_kg": "mass", "inertia_kgm2": "inertia", "drag_n": "drag at 0.2 m/s", "turn_drag_nm": "turn drag"}


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    legs: int = 12  # of the trial


def alone(seed: int, pose: Pose, behaviour: Behaviour) -> Fleet:
    return basin.fleet({"r1": basin.robot("r1", pose, behaviour)}, seed)


def swum(seed: int, legs: int) -> tuple[body_calibration.Trial, dict[str, float]]:
    """A trial, and what is true of the robot for each newton that it asked for."""
    fleet, events, given, asked = alone(seed, MIDDLE, Trial(x_m=MIDDLE.x_m, y_m=MIDDLE.y_m)), {}, [], []
    with twin_bodies(fleet) as bodies:
        one = Swimmers(fleet, bodies)
        swimmer = swimmer_of(one.agents["r1"].capabilities)
        for _ in one.each_step(TRIAL_S):
            events.update(dict.fromkeys(swimmer.localizer.events))
            progress = swimmer.active.progress
            if progress is not None:
                f = bodies._dive.states["thrust_n"][0, 4:]  # of the flat thrusters: N ahead, N left, N m
                given.append((-np.sum(np.sin(RING_RAD) * f), np.sum(np.cos(RING_RAD) * f), RING_M * np.sum(f)))
                asked.append(swimmer.localizer.at(one.now_ns).force)
                if progress.stage.leg >= legs:
                    break
        body = bodies._dive.bodies[0].copy()
    if not given:
        raise Failed("the robot does not swim")
    given_n, asked_n = np.array(given), np.array(asked)
    gain = (given_n * asked_n).sum(axis=0) / (asked_n * asked_n).sum(axis=0)
    push, twist = float(gain[:2].mean()), float(gain[2])
    v, r = SPEED_M_S, RATE_RAD_S
    drag_n = body["linear_drag"][:2].mean() * v + (body["quadratic_drag"][:2].mean() + body["tether_drag"]) * v * v
    truth = {
        "mass_kg": (body["mass_kg"] + body["added_kg"][:2].mean()) / push,
        "drag_n": drag_n / push,
        "inertia_kgm2": (body["inertia_kgm2"][2] + body["added_inertia_kgm2"][2]) / twist,
        "turn_drag_nm": (body["linear_drag"][5] * r + body["quadratic_drag"][5] * r * r) / twist,
    }
    return body_calibration.Trial(tuple(sorted(events)), False), {key: float(value) for key, value in truth.items()}


def fitted(fit: BodyFit) -> dict[str, float]:
    """The same of what was fitted."""
    v, r = SPEED_M_S, RATE_RAD_S
    drags = {"drag_n": fit.drag * v + fit.drag2 * v * v, "turn_drag_nm": fit.turn_drag * r + fit.turn_drag2 * r * r}
    return {"mass_kg": fit.mass_kg, "inertia_kgm2": fit.inertia_kgm2, **drags}


def gone(seed: int, body: BodyFit | None) -> tuple[float, float | None]:
    """A goto of half a metre: mm that it swims beyond, and s until it stays within 2 cm."""
    fleet = alone(seed, FROM, TO)
    with twin_bodies(fleet) as bodies:
        one = Swimmers(fleet, bodies)
        one.agents["r1"] = Agent(fleet, "r1", msgspec.structs.replace(one.calibrations["r1"], body=body), START_NS)
        if not one.until_swims("r1", FIND_S):
            raise Failed("the robot does not swim")
        t_s, x_m, y_m, _ = one.path("r1", GOTO_S).T
    overshoot_m = max(float((x_m - TO.x_m).max()), 0.0)
    return 1e3 * overshoot_m, settled_s(t_s, np.hypot(x_m - TO.x_m, y_m - TO.y_m), NEAR_M)


# --- the claim ---


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises Failed where a firmware hangs or a robot never swims, CalibrationRefused where a trial says too little."""
    trial, truth = swum(seed, settings.legs)
    fit = body_calibration.fit_body(trial)
    row: Row = {key: value / truth[key] - 1.0 for key, value in fitted(fit).items()}
    row["mass_sigmas"] = row["mass_kg"] / fit.sigma[0]
    for name, body in (("usual", None), ("calibrated", fit)):
        row[f"{name}_overshoot_mm"], row[f"{name}_s"] = gone(seed, body)
    return [row]


def summary(rows: Rows) -> dict[str, Value]:
    of = {key: [row[key] for row in rows["all"]] for key in rows["all"][0]}
    found: dict[str, Value] = {key: 1e2 * rms(of[key]) for key in CONSTANTS}
    found["mass_sigmas"] = rms(of["mass_sigmas"])
    for key in ("usual_overshoot_mm", "usual_s", "calibrated_overshoot_mm", "calibrated_s"):
        found[key] = None if None in of[key] else math.fsum(of[key]) / len(of[key])
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"legs": 6},
    measured_on="twin",
    figures=(
        *(Figure(key, f"{words}: error of a trial, rms", "%") for key, words in CONSTANTS.items()),
        Figure("mass_sigmas", "mass: error, of what the trial says of it, rms", "sigma"),
        Figure("usual_overshoot_mm", "goes 0.5 m with the usual constants: overshoot, mean", "mm"),
        Figure("calibrated_overshoot_mm", "the same with its own", "mm"),
        Figure("usual_s", "goes 0.5 m with the usual constants: within 20 mm for good, mean", "s"),
        Figure("calibrated_s", "the same with its own", "s"),
    ),
    explanation="""A robot swims the trial of `aucamp calibrate body`, and what is fitted to its recording is compared
        with what the twin drew, for each newton that is asked of the thrusters. Then it goes half a metre, once with
        the constants that all robots begin with, and once with its own.""",
)
