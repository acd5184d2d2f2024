"""Robots that swim and survey in the dark, in virtual time: whole kernels, drawn blocks and tags, lamps watched apart.

A robot sees tags while its own lamp burns, and none else. What a sweep's blocks show is as in the experiment on
swimmers, whatever the light: what is watched here is which lamps burn, who holds still, and which sweeps count.
"""

from __future__ import annotations

from typing import NamedTuple

from msgspec.structs import replace

from agent.core.config import Fleet, Lighting
from agent.experiments.navigation.basin import START_NS
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.reconstruction.coverage import draw_scene
from agent.experiments.reconstruction.survey import SurveyEyes, WideBodies, swimming_fleet
from tests.capabilities.light.lit_swarm import HARBOUR


class Kept(NamedTuple):
    """A keyframe, and what happened while it was swept."""

    robot: str
    lamps: tuple[str, ...]  # that burned
    altered: tuple[str, ...]  # whose light was altered by a command from the sweep's first step to its last


class DarkEyes(SurveyEyes):
    """One robot's camera."""

    world: DarkSurvey

    def expose(self, bodies, name: str, step: int, sees_tags: bool) -> None:
        super().expose(bodies, name, step, self.world.light[name][0] > 0.0)

    def sweep(self, plan) -> None:
        super().sweep(plan)
        self.world.began(self.name)


class DarkSurvey(Swimmers):
    """Three robots of the experiment's fleet, with lamps."""

    def __init__(self, seed: int, lighting: Lighting = HARBOUR, fleet: Fleet | None = None) -> None:
        fleet = fleet or swimming_fleet(seed)
        lamps = {name: replace(robot, lamp=True) for name, robot in fleet.robot.items()}
        fleet = replace(fleet, robot=lamps, lighting=lighting)
        bodies = WideBodies(fleet)
        super().__init__(fleet, bodies)
        length, breadth, _ = fleet.tank.size_m
        scene = draw_scene((length, breadth, fleet.tank.surface_m), seed, 4)
        self.eyes = {}
        for name in fleet.robot:
            eyes = self.eyes[name] = DarkEyes(fleet, name, bodies, scene)
            eyes.world, eyes.name = self, name
        self.light: dict[str, tuple[float, tuple[int, ...]]] = dict.fromkeys(fleet.robot, (0.0, (0, 0)))
        self.kept: list[Kept] = []
        self.spoiled: list[str] = []
        self._sweeps: dict[str, tuple[tuple[str, ...], set[str]]] = {}
        self._made = dict.fromkeys(fleet.robot, 0)

    def began(self, name: str) -> None:
        self._sweeps[name] = tuple(other for other, light in self.light.items() if light[0]), set()

    def step(self) -> None:
        super().step()
        for name, outputs in self.outputs.items():
            light = outputs.set_point.light, outputs.set_point.servos_us[2:]
            altered = light != self.light[name] and bool(light[0] or self.light[name][0])
            self.light[name] = light
            for eyes, (_, whose) in self._sweeps.items():
                if altered and self.eyes[eyes]._plan is not None:
                    whose.add(name)
            self.spoiled += [line.text for line in outputs.log if "spoiled" in line.text]
        for name, agent in self.agents.items():
            own = agent.capabilities["survey"].surveyor
            if own is not None and own.keyframes > self._made[name]:
                self._made[name] = own.keyframes
                lamps, whose = self._sweeps[name]
                self.kept.append(Kept(name, lamps, tuple(sorted(whose))))

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 20)):
            self.step()

    @property
    def seconds(self) -> float:
        return (self.now_ns - START_NS) * 1e-9
