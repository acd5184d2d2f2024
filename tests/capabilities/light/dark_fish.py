"""Robots that swim after a fish in the dark, in virtual time (dark_water.py), and at first have to find it."""

from __future__ import annotations

from msgspec.structs import replace

from agent.capabilities.light.followers import FAINT, PLAIN
from agent.core.config import Follow, Lighting, Look, Target
from agent.experiments.following_dive import LENGTH_M, DrawnFish
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import PlanarBodies
from agent.experiments.navigation.pursuit import Wanderer
from hw.twin.scene import generator
from tests.capabilities.light.dark_search import drawn_fleet
from tests.capabilities.light.dark_water import DarkWater
from tests.capabilities.light.lit_swarm import HARBOUR

STANDOFF_M = 0.7


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
        super().__init__(fleet, bodies, path, 0.5 * LENGTH_M, 0.5 * (FAINT + PLAIN))
        for name, eyes in self.eyes.items():
            eyes.ball, eyes.hide = DrawnFish(fleet, name, bodies.camera(name), path), fleet.robot[name].neighbours
        self.saw: list[tuple[bool, ...]] = []  # each robot, of each of its newest frames

    def step(self) -> None:
        super().step()
        if any(inputs.sightings for inputs in self.inputs.values()):
            self.saw.append(tuple(any(s.found for s in inputs.sightings) for inputs in self.inputs.values()))
