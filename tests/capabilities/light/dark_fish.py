"""Robots that swim after a fish in the dark, in virtual time (dark_water.py), and at first have to find it."""

from __future__ import annotations

import math

import numpy as np
from msgspec.structs import replace

from agent.capabilities.light.light_request import SHOWS_SIDE
from agent.core.config import Fleet, Follow, Lighting, Look, Pose, Search, Target
from agent.core.messages import Vector
from agent.experiments.following_dive import LENGTH_M, DrawnFish, Wanderer
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import PlanarBodies
from hw.twin.scene import generator
from tests.capabilities.light.dark_water import DarkWater
from tests.capabilities.light.lit_swarm import HARBOUR

STANDOFF_M = 0.7
RADIUS_M = 0.07
NEAR_M = 0.45  # of the target at first, where nobody starts


class DarkFish(DarkWater):
    """Robots with lamps, each told to follow the fish, and to search for it where nobody knows it."""

    def __init__(self, seed: int, speed_m_s: float, seconds: float, lighting: Lighting = HARBOUR) -> None:
        drawn, _ = drawn_fleet(seed, lighting)
        fish = Target(detector="creature", length_m=LENGTH_M, speed_m_s=speed_m_s, turn_s=basin.TURN_S)
        told = Follow(target="ball", standoff_m=STANDOFF_M, search=True)
        robots = {
            name: replace(robot, behaviour=told, look=Look(tilt_deg=-10.0)) for name, robot in drawn.robot.items()
        }
        fleet = replace(drawn, robot=robots, target={"ball": fish})
        path = Wanderer(generator(seed, "dark fish"), speed_m_s, seconds).at
        bodies = PlanarBodies(fleet)
        super().__init__(fleet, bodies, path, 0.5 * LENGTH_M, SHOWS_SIDE)
        for name, eyes in self.eyes.items():
            eyes.ball, eyes.hide = DrawnFish(fleet, name, bodies.camera(name), path), fleet.robot[name].neighbours
        self.saw: list[tuple[bool, ...]] = []  # each robot, of each of its newest frames

    def step(self) -> None:
        super().step()
        if any(inputs.sightings for inputs in self.inputs.values()):
            self.saw.append(tuple(any(s.found for s in inputs.sightings) for inputs in self.inputs.values()))


def drawn_fleet(seed: int, lighting: Lighting, robots: int = 3) -> tuple[Fleet, Vector]:
    """Robots at drawn places of the experiment's basin, and where the target is at first."""
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
