"""Three robots hold their places around a ball and say where it is: as well as all that they measured allows?

The bound is the error of a filter that has every measurement of all of them (joint_bound.py).
"""

from __future__ import annotations

import math

import numpy as np

from agent.core.config import Look, Pose
from agent.core.linear_algebra import wrap
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK
from agent.experiments.navigation.bodies import twin_bodies
from agent.experiments.navigation.joint_bound import joint_filter_of
from agent.experiments.navigation.joint_filter import Array, full
from agent.experiments.navigation.notes import Notes, Sample
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.result import Row
from hw.twin.scene import generator

ROBOTS, AROUND_M, SECONDS = 3, 0.75, 60.0
BALL_M = (0.5 * TANK.size_m[0], 0.5 * TANK.size_m[1], 0.07)
BALL_LOOK = Look(tilt_deg=-20.0)


def ball(seed: int, seconds: float = SECONDS) -> Row:
    """Errors of the robots and of the bound at the end, and both normalised errors squared, a third."""
    rng = generator(seed, "ball")
    names, first = [f"r{i + 1}" for i in range(ROBOTS)], float(rng.uniform(-math.pi, math.pi))
    robots = {}
    for k, name in enumerate(names):
        way = first + 2.0 * math.pi * k / ROBOTS + float(rng.uniform(-0.2, 0.2))
        x, y = BALL_M[0] + AROUND_M * math.cos(way), BALL_M[1] + AROUND_M * math.sin(way)
        pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(wrap(way + math.pi)))
        others = tuple(other for other in names if other != name)
        robots[name] = basin.robot(name, pose, None, BALL_LOOK, others)
    fleet = basin.fleet(robots, seed)
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies, BALL_M)
        notes = Notes(swimmers)
        for _ in range(round(seconds * 20.0)):
            swimmers.step()
            notes.take()
        own = [swimmers.agents[name].current.estimator.posterior for name in names]
    joint = joint_filter_of(notes.measured, fleet, list(swimmers.calibrations.values()))
    at, covariance = joint.target
    errors = [np.array(known.x_m) - BALL_M for known in own if known is not None]
    return {
        "robots": ROBOTS,
        "told": len(errors),
        "error_mm": [1e3 * float(np.linalg.norm(e)) for e in errors],
        "nees": [_nees(e, full(known.cov_m2)) for e, known in zip(errors, filter(None, own), strict=True)],
        "bound_mm": 1e3 * float(np.linalg.norm(at - BALL_M)),
        "bound_nees": _nees(at - BALL_M, covariance),
        "bound_sigma_mm": 1e3 * math.sqrt(float(np.trace(covariance))),
        "samples": sum(isinstance(one.what, Sample) for one in notes.measured),
    }


def _nees(e: Array, covariance: Array) -> float:
    """A third of the normalised error squared: 1 where it is honest."""
    return float(e @ np.linalg.solve(covariance, e)) / 3.0
