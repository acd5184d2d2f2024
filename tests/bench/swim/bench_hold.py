"""How well a robot holds its place and orbits in the rendered basin: its true path against what was asked for, and
against what it believes.

Robots of the shipped fleet `swim`, each alone. A seed is another world: body, lens, gimbal, water, survey of the tags.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace

from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Look, Orbit
from agent.core.linear_algebra import wrap
from agent.experiments.claim import Claim, Figure, Row, Rows, Value, rms
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from hw.twin.dive import run_in_lock_step
from hw.twin.physics.body import euler_rad
from tests.bench.lockstep import START_NS, divers_of

FROM_S = 15.0  # of a dive, what counts of it begins


class Case(NamedTuple):
    """A robot of the fleet, what it is told, and where it looks if not as the fleet file says."""

    robot: str
    words: str
    behaviour: Orbit | None = None
    look: Look | None = None


CASES = {  # a robot that swims alone sees its target where it looks, or never
    "tags": Case("r1", "holds its place, tags in sight"),
    "no-tags": Case("r3", "holds its place, no tags in sight", look=Look(pan_deg=10.0, tilt_deg=-13.0)),
    "orbit": Case("r2", "orbits, few tags in sight", Orbit(x_m=1.6, y_m=1.05, radius_m=0.7)),
}


def swim(case: Case, seed: int, seconds: float) -> np.ndarray:
    """Rows (n, 6) of each step: t s, true x, y m and yaw rad, believed x and y (NaN: none)."""
    fleet, name, rows = load_fleet(fleet_file("swim")), case.robot, []
    robot = fleet.robot[name]
    robot = replace(robot, neighbours=(), behaviour=case.behaviour, look=case.look or robot.look)
    fleet = replace(fleet, robot={name: robot}, twin=replace(fleet.twin, seed=seed))
    with divers_of(fleet) as (dive, divers):
        while dive.now_ns - START_NS < seconds * 1e9:
            if divers[name].tick() is not None:
                here = swimmer_of(divers[name].agent.capabilities).localizer.at(dive.now_ns)
                true = *dive.states[0]["position_m"][:2], euler_rad(dive.states[0]["quaternion"])[2]
                believed = (np.nan, np.nan) if here is None else here.pose[:2]
                rows.append([(dive.now_ns - START_NS) * 1e-9, *true, *believed])
            run_in_lock_step(dive, 1)
    return np.array(rows, float)


# --- the claim ---


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seconds: float = 32.0


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Root mean squares. A robot that does not know where it is has no number."""
    way = swim(CASES[case], seed, settings.seconds)
    way = way[way[:, 0] > FROM_S]
    off_m, off_rad = _off(way, CASES[case])
    own_m = np.hypot(*(way[:, 4:6] - way[:, 1:3]).T)
    off = {"off_mm": 1e3 * off_m, "yaw_deg": np.degrees(off_rad), "own_mm": 1e3 * own_m}
    return [{key: rms(values.tolist()) for key, values in off.items()}]


def _off(way: np.ndarray, case: Case) -> tuple[np.ndarray, np.ndarray]:
    """How far it truly is from where it shall be: from its pose, or from its circle; and from its yaw."""
    pose, behaviour = load_fleet(fleet_file("swim")).robot[case.robot].pose, case.behaviour
    wrapped = np.vectorize(wrap)
    if behaviour is None:
        return np.hypot(way[:, 1] - pose.x_m, way[:, 2] - pose.y_m), wrapped(way[:, 3] - math.radians(pose.yaw_deg))
    x, y = behaviour.x_m - way[:, 1], behaviour.y_m - way[:, 2]
    return np.hypot(x, y) - behaviour.radius_m, wrapped(np.arctan2(y, x) - way[:, 3])


KEYS = {"off_mm": "off, rms", "yaw_deg": "yaw off, rms", "own_mm": "its own estimate of its place off, rms"}


def summary(rows: Rows) -> dict[str, Value]:
    """Of all seeds."""
    found: dict[str, Value] = {}
    for case, of in rows.items():
        for key in KEYS:
            values = [row[key] for row in of]
            found[f"{case}_{key}"] = None if None in values else rms(values)
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(CASES),
    quick={"seconds": 17.0},
    seeds=10,
    measured_on="twin",
    figures=tuple(
        Figure(f"{case}_{key}", f"{of.words}: {words}", key.rpartition("_")[2])
        for case, of in CASES.items()
        for key, words in KEYS.items()
    ),
    explanation="""One robot of the fleet `swim` at a time swims in its rendered basin, under its own firmware, vision
        and kernel; all wait for the twin's clock. Without tags it goes by points of floor and walls that it follows
        from frame to frame.""",
)
