"""The tank of one seed, what lies in it, and where cameras stand: five moored robots, and five other places."""

from __future__ import annotations

import math
from typing import NamedTuple

import msgspec
import numpy as np

from agent.core.config import WaterKind
from agent.experiments.still_camera import TankView
from hw.twin.scene import Scene, Solid, generator, load_scene

BALL_M = 0.07
STONES = 4
# Robots of the paper's tank (agent/fleets/tank.toml): x, y, yaw.
MOORED = {
    "r1": (0.30, 0.25, 34.0),
    "r2": (1.25, 0.30, 152.0),
    "r3": (0.70, 1.05, 277.0),
    "r4": (1.28, 0.85, 209.0),
    "r5": (0.20, 0.75, 341.0),
}
DEPTHS_M = (0.10, 0.22, 0.36)
TILTS_DEG = (-32.0, -20.0, -8.0)  # one for each depth: lower cameras look less far down
PANS_DEG = (-30.0, 0.0, 30.0)
SURFACE_M = 0.5
# Held back: each robot once more between its pans, and five places where none was.
BETWEEN = {"r1": (0.16, 15.0), "r2": (0.28, -15.0), "r3": (0.16, -15.0), "r4": (0.28, 15.0), "r5": (0.22, 15.0)}
NEW = (
    (0.75, 0.18, 92.0, 0.15, -28.0),
    (1.35, 0.60, 178.0, 0.22, -18.0),
    (1.00, 1.05, 245.0, 0.20, -22.0),
    (0.45, 0.55, 20.0, 0.12, -30.0),
    (0.40, 1.05, 310.0, 0.28, -14.0),
)
CLEAR_M = 0.17  # from the middle of a stone to the middle of a camera, across


class Station(NamedTuple):
    """One view: which robot's camera takes it, where it stands and looks."""

    robot: str
    view: TankView


def scene_of_seed(seed: int, water: WaterKind) -> Scene:
    """The paper's tank of seed 0; other seeds have their ball and stones drawn, clear of every station."""
    tank = load_scene("tank")
    kind = msgspec.structs.replace(tank.water, preset=water)
    return msgspec.structs.replace(tank, water=kind, solid=tank.solid if seed == 0 else drawn_solids(seed))


def drawn_solids(seed: int) -> tuple[Solid, ...]:
    """A ball and STONES stones of any shape on the floor, none in another or in a camera."""
    rng, solids = generator(seed, "reconstruction", "solids"), list[Solid]()
    places = [*((x, y) for x, y, _ in MOORED.values()), *((x, y) for x, y, *_ in NEW)]
    while len(solids) <= STONES:
        x, y = rng.uniform(0.3, 1.2), rng.uniform(0.25, 0.95)
        radii = (BALL_M,) * 3 if not solids else tuple(rng.uniform(0.04, 0.09, 3).tolist())
        near = max(radii[0], radii[1])
        free = all(math.hypot(x - px, y - py) > CLEAR_M for px, py in places)
        apart = all(math.dist((x, y), s.position_m[:2]) > near + max(s.radii_m[:2]) + 0.01 for s in solids)
        if free and apart:
            height = radii[2] * (1.0 if not solids else rng.uniform(0.5, 0.9))
            kind = "stone" if solids else "ball"
            solids.append(msgspec.convert({"kind": kind, "position_m": (x, y, height), "radii_m": radii}, Solid))
    return tuple(solids)


def trained() -> list[Station]:
    """45 views: every robot at three depths, turned three ways."""
    return [
        Station(robot, TankView((x, y, SURFACE_M - depth), yaw + pan, tilt))
        for robot, (x, y, yaw) in MOORED.items()
        for depth, tilt in zip(DEPTHS_M, TILTS_DEG, strict=True)
        for pan in PANS_DEG
    ]


def held_back_known() -> list[Station]:
    """A view of each robot that is not trained on, from where it stands."""
    found = []
    for robot, (depth, pan) in BETWEEN.items():
        x, y, yaw = MOORED[robot]
        tilt = float(np.interp(depth, DEPTHS_M, TILTS_DEG))
        found.append(Station(robot, TankView((x, y, SURFACE_M - depth), yaw + pan, tilt)))
    return found


def held_back_new() -> list[Station]:
    """Views from where no robot was; with the camera of the robot of that number."""
    return [
        Station(robot, TankView((x, y, SURFACE_M - depth), yaw, tilt))
        for robot, (x, y, yaw, depth, tilt) in zip(MOORED, NEW, strict=True)
    ]
