"""Mass and drag by a trial against what the twin drew, and a goto with them and without:
`python -m tests.bench.swim.bench_body SEED ...`."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Goto, Pose, Trial
from agent.core.ranging.camera_model import BodyFit
from agent.tools import body_calibration
from hw.twin.physics.forces import RING_M, RING_RAD
from tests.bench.swim.drawn import MIDDLE, DrawnSwimmer, drawn, swimming

LEGS, MOST_S = 12, 200.0
SPEED_M_S, RATE_RAD_S = 0.2, 0.6  # at which drags are compared: two that share it are told apart badly
FROM, TO = Pose(x_m=1.25, y_m=1.0, yaw_deg=0.0), Goto(x_m=1.75, y_m=1.0, yaw_deg=0.0)
NEAR_M = 0.02


def swum(seed: int, gyro: bool = False) -> tuple[body_calibration.Trial, dict[str, float]]:
    """A trial, and what is true of the robot for each newton that it asked for."""
    of = swimming(seed, Trial(x_m=MIDDLE.x_m, y_m=MIDDLE.y_m), gyro=gyro)
    given, asked = [], []
    with tempfile.TemporaryDirectory() as folder, drawn(of, Path(folder)) as one:
        for _ in range(round(20 * MOST_S)):
            one.step()
            progress = swimmer_of(one.agent.capabilities).active.progress
            if progress is not None:
                given.append(planar_n(one))
                asked.append(one.believed.force)
                if progress.stage.leg >= LEGS:
                    break
        body = one.dive.bodies[0].copy()
    given, asked = np.array(given), np.array(asked)
    gain = (given * asked).sum(axis=0) / (asked * asked).sum(axis=0)
    push, twist = float(gain[:2].mean()), float(gain[2])
    v, r = SPEED_M_S, RATE_RAD_S
    drag = body["linear_drag"][:2].mean() * v + (body["quadratic_drag"][:2].mean() + body["tether_drag"]) * v * v
    truth = {
        "mass_kg": (body["mass_kg"] + body["added_kg"][:2].mean()) / push,
        "drag_n": drag / push,
        "inertia_kgm2": (body["inertia_kgm2"][2] + body["added_inertia_kgm2"][2]) / twist,
        "turn_drag_nm": (body["linear_drag"][5] * r + body["quadratic_drag"][5] * r * r) / twist,
        "thrust_gain": push,
    }
    return body_calibration.Trial(tuple(sorted(one.events)), gyro), {key: float(value) for key, value in truth.items()}


def planar_n(one: DrawnSwimmer) -> tuple[float, float, float]:
    """What the flat thrusters give: N ahead, N left, N m."""
    f = one.dive.states["thrust_n"][0, 4:]
    return -float(np.sum(np.sin(RING_RAD) * f)), float(np.sum(np.cos(RING_RAD) * f)), RING_M * float(np.sum(f))


def found(fit: BodyFit) -> dict[str, float]:
    """The same of what was fitted."""
    v, r = SPEED_M_S, RATE_RAD_S
    drags = {"drag_n": fit.drag * v + fit.drag2 * v * v, "turn_drag_nm": fit.turn_drag * r + fit.turn_drag2 * r * r}
    return {"mass_kg": fit.mass_kg, "inertia_kgm2": fit.inertia_kgm2, **drags}


def gone(seed: int, body: BodyFit | None) -> dict[str, float]:
    """A goto of half a metre: how far beyond it the robot swims, and after how long it stays within 2 cm."""
    with tempfile.TemporaryDirectory() as folder, drawn(swimming(seed, TO, FROM), Path(folder), body) as one:
        for _ in range(400):  # until it knows where it is; it swims from then on
            one.step()
            if swimmer_of(one.agent.capabilities).active.progress is not None:
                break
        path = one.run(14.0)
    along, off = path[:, 0] - TO.x_m, np.hypot(path[:, 0] - TO.x_m, path[:, 1] - TO.y_m)
    began = int(np.argmax(path[:, 0] - path[0, 0] > 0.01))
    far = np.flatnonzero(off > NEAR_M)
    return {"overshoot_mm": 1e3 * float(along.max()), "settled_s": (int(far[-1]) + 1 - began) / 20.0}


def run() -> dict[str, dict]:
    """One seed; more by hand."""
    trial, truth = swum(1)
    mass = body_calibration.fit_body(trial).mass_kg
    return {"trial_mass": {"value": mass, "unit": "kg", "against": "true", "ratio": mass / truth["mass_kg"]}}


if __name__ == "__main__":
    for seed in map(int, sys.argv[1:]):
        trial, truth = swum(seed)
        fit = body_calibration.fit_body(trial)
        ratios = {key: round(value / truth[key], 3) for key, value in found(fit).items()}
        sigma = [round(s, 3) for s in fit.sigma]
        told = {
            "ratios": ratios,
            "sigma": sigma,
            "misfit": round(fit.misfit, 2),
            "gain": round(truth["thrust_gain"], 3),
        }
        told |= {"truth": {key: round(value, 3) for key, value in truth.items()}}
        gotos = {name: gone(seed, body) for name, body in (("as others", None), ("calibrated", fit))}
        told |= {name: {key: round(value, 2) for key, value in row.items()} for name, row in gotos.items()}
        print(seed, json.dumps(told), flush=True)
