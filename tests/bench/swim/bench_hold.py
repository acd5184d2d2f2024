"""How well a robot holds its place and orbits in the rendered basin: its true path against what was asked for, and
against what it believes. `python -m tests.bench hold`; a minute of processor time each.
"""

import math

import numpy as np

from agent.core.config import Look, Orbit
from agent.core.linear_algebra import wrap
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from tests.bench.swim.lockstep import swim

SECONDS, FROM_S = 32.0, 15.0  # of a dive, and what counts of it
CASES = (  # whoever swims alone sees its target where it looks, or never
    ("hold_tags_in_sight", "r1", 8, None, None),
    ("hold_tags_in_sight", "r2", 11, None, None),
    ("hold_no_tags_in_sight", "r3", 8, None, Look(pan_deg=10.0, tilt_deg=-13.0)),
    ("orbit_few_tags", "r2", 8, Orbit(x_m=1.6, y_m=1.05, radius_m=0.7), None),
)


def run() -> dict[str, dict]:
    rows = {}
    for what, name, seed, behaviour, look in CASES:
        way = swim(name, seed, SECONDS, behaviour, look)
        off_m, off_rad = _off(way, name, behaviour)
        believed_m = np.hypot(*(way[:, 4:6] - way[:, 1:3]).T)
        counts, key = way[:, 0] > FROM_S, f"{what}_{name}_{seed}"
        rows[key] = _rms(1e3 * off_m[counts], "mm")
        rows[f"{key}_yaw"] = _rms(np.degrees(off_rad[counts]), "deg")
        rows[f"{key}_own_place"] = _rms(1e3 * believed_m[counts], "mm")
    return rows


def _off(way: np.ndarray, name: str, behaviour: Orbit | None) -> tuple[np.ndarray, np.ndarray]:
    """How far it truly is from where it shall be: from its pose, or from its circle; and from its yaw."""
    pose = load_fleet(fleet_file("swim")).robot[name].pose
    wrapped = np.vectorize(wrap)
    if behaviour is None:
        return np.hypot(way[:, 1] - pose.x_m, way[:, 2] - pose.y_m), wrapped(way[:, 3] - math.radians(pose.yaw_deg))
    x, y = behaviour.x_m - way[:, 1], behaviour.y_m - way[:, 2]
    return np.hypot(x, y) - behaviour.radius_m, wrapped(np.arctan2(y, x) - way[:, 3])


def _rms(values: np.ndarray, unit: str) -> dict:
    return {"value": float(np.sqrt(np.mean(values**2))), "unit": unit, "against": "what it shall be", "ratio": None}
