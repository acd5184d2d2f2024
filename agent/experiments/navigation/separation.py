"""How near robots come to each other, centre to centre and by the truth, while all of them swim across the basin.

Each starts where another one shall be: their ways cross. They are neighbours, all of all, and what they say arrives.
The crew arms them when all have found themselves: nobody keeps clear of a robot that cannot say where it is.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from agent.core.config import Goto, Pose
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK
from agent.experiments.navigation.bodies import PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.result import Row
from hw.twin.scene import generator

CROSSING_ROBOTS, CROSSING_S = 10, 30.0
FIND_S = 30.0  # in the hands of the crew, at most
APART_M = 0.45  # places that are told; the fleet file demands 0.36
CLEAR_M = 0.22  # from walls

Array = NDArray[np.float64]


def crossing(seed: int, robots: int = CROSSING_ROBOTS, seconds: float = CROSSING_S) -> Row:
    """Least distance (m) of any two, and the share of robots that are within 5 cm of their goals at the end."""
    rng = generator(seed, "crossing")
    starts = places(rng, robots)
    goals = np.roll(starts, 1 + int(rng.integers(robots - 1)), axis=0)  # nobody stays where it is
    names = [f"r{i + 1}" for i in range(robots)]
    fleet = basin.fleet(
        {
            name: basin.robot(
                name,
                Pose(x_m=float(start[0]), y_m=float(start[1]), yaw_deg=float(rng.uniform(-180.0, 180.0))),
                Goto(x_m=float(goal[0]), y_m=float(goal[1])),
                neighbours=tuple(other for other in names if other != name),
            )
            for name, start, goal in zip(names, starts, goals, strict=True)
        },
        seed,
    )
    bodies = PlanarBodies(fleet)
    swimmers = Swimmers(fleet, bodies)
    bodies.armed = False
    for _ in range(round(FIND_S * 20.0)):
        swimmers.step()
        if all(agent.swimmer is not None and not agent.swimmer.lost for agent in swimmers.agents.values()):
            break
    bodies.armed = True
    least = math.inf
    paths = []
    for _ in range(round(seconds * 20.0)):
        swimmers.step()
        here = np.array([swimmers.place(name)[:2] for name in names])
        least = min(least, float(np.linalg.norm(here[:, None] - here[None], axis=2)[np.triu_indices(robots, 1)].min()))
        paths.append(here)
    arrived = np.linalg.norm(paths[-1] - goals, axis=1) < 0.05
    return {"robots": robots, "least_m": least, "arrived": float(arrived.mean()), "path": np.array(paths)}


def places(rng: np.random.Generator, robots: int) -> Array:
    """Places (robots, 2) in the basin, APART_M and more from each other; a draw that gets stuck starts again."""
    low, high = np.full(2, CLEAR_M), np.array(TANK.size_m[:2]) - CLEAR_M
    while True:
        found: list[Array] = []
        for _ in range(200):
            place = rng.uniform(low, high)
            if all(np.linalg.norm(place - other) >= APART_M for other in found):
                found.append(place)
            if len(found) == robots:
                return np.array(found)
