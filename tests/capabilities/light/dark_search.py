"""Robots that swim in search of a ball in the dark, in virtual time (dark_water.py), all at drawn places."""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from agent.capabilities.light.light_request import SHOWS
from agent.core.config import Fleet, Lighting, Pose, Search
from agent.core.messages import Vector
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import PlanarBodies
from hw.twin.scene import generator
from tests.capabilities.light.dark_water import DarkWater
from tests.capabilities.light.lit_swarm import HARBOUR

RADIUS_M = 0.07
NEAR_M = 0.45  # of the ball, where nobody starts


class DarkSearch(DarkWater):
    """Robots with lamps, each told to search."""

    def __init__(self, seed: int, lighting: Lighting = HARBOUR) -> None:
        fleet, ball_m = drawn_fleet(seed, lighting)
        super().__init__(fleet, PlanarBodies(fleet), lambda now_ns: ball_m, RADIUS_M, SHOWS)
        self.first_s: float | None = None  # the ball in a frame
        self.measured_s: dict[str, float] = {}  # by each robot, for the first time, and by whose lamps
        self.by: dict[str, tuple[str, ...]] = {}

    def step(self) -> None:
        super().step()
        if self.first_s is None and any(s.found for inputs in self.inputs.values() for s in inputs.sightings):
            self.first_s = self.seconds
        for name, outputs in self.outputs.items():
            if outputs.outcome and outputs.outcome.x_m is not None and name not in self.measured_s:
                self.measured_s[name] = self.seconds
                self.by[name] = tuple(outputs.outcome.lit or ())


def drawn_fleet(seed: int, lighting: Lighting, robots: int = 3) -> tuple[Fleet, Vector]:
    """Robots at drawn places of the experiment's basin, and where the ball lies."""
    rng = generator(seed, "dark search")
    length, breadth, _ = basin.TANK.size_m
    ball_m = *(float(at) for at in rng.uniform((0.4, 0.4), (length - 0.4, breadth - 0.4))), RADIUS_M
    places: list[np.ndarray] = []
    while len(places) < robots:
        at = rng.uniform((0.35, 0.35), (length - 0.35, breadth - 0.35))
        if min([np.hypot(*(at - other)) for other in places], default=9.0) > 0.6 and _far(at, ball_m):
            places.append(at)
    names = [f"r{k + 1}" for k in range(robots)]
    told = {
        name: replace(
            basin.robot(
                name,
                Pose(x_m=float(x), y_m=float(y), yaw_deg=float(rng.uniform(-180.0, 180.0))),
                Search(target="ball"),
                neighbours=tuple(other for other in names if other != name),
            ),
            lamp=True,
        )
        for name, (x, y) in zip(names, places, strict=True)
    }
    return replace(basin.fleet(told, seed), lighting=lighting), ball_m


def _far(at: np.ndarray, ball_m: Vector) -> bool:
    return math.dist(at, ball_m[:2]) > NEAR_M
