"""Agents in the dark, in virtual time: scripted cameras that see by lamps alone, a network that does what it likes.

What lamps truly did is kept apart from all that robots say of them: each command that altered one, and when.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from random import Random
from typing import NamedTuple
from unittest.mock import patch

from msgspec.structs import replace

from agent.capabilities.light.allocate import DARK_NS, Choice, Lamp, Scene
from agent.core.codec import encode
from agent.core.config import Fleet, Lighting, WaterOptics
from agent.core.step_io import Heard, Inputs, Outputs, Sighting
from agent.core.topics import LIGHT
from agent.demo.demo import demo_fleet
from agent.robot.step import Agent
from tests.network.scripted_agent import CALIBRATION, Motors, Script

START_NS, STEP_NS = 10**18, 50_000_000
HARBOUR = Lighting(
    water=WaterOptics(absorption_per_m=(0.55, 0.37, 0.45), scattering_per_m=(1.82, 1.82, 1.82)), guard_s=0.3
)


class Weather(NamedTuple):
    """What happens to messages and robots, by chance."""

    loss: float = 0.0
    late: float = 0.0  # share of messages that take one to six steps longer: later ones overtake them
    twice: float = 0.0  # share that comes again, late
    restarts_hz: float = 0.0  # of each robot: down for a second, and back without memory
    disarmed_hz: float = 0.0  # of each robot: for a second and a half


CALM = Weather()


class Swept(NamedTuple):
    """A sweep that the kernel took a place from, and the commands that altered any lamp while it ran."""

    robot: str
    lamps: tuple[str, ...]  # that it took to burn
    altered: tuple[tuple[str, int], ...]
    burned: tuple[str, ...]  # truly


def lit_fleet(robots: int = 3, lighting: Lighting | None = HARBOUR) -> Fleet:
    fleet = demo_fleet(robots, "evidence", 0.0, 0, False, Path("/nowhere"))
    lamps = {name: replace(robot, lamp=lighting is not None) for name, robot in fleet.robot.items()}
    return replace(fleet, robot=lamps, lighting=lighting)


def lend_all(own: str, scene: Scene, lamps: Mapping[str, Lamp], lighting: Lighting) -> Choice:
    """In the place of the rule: all that are free, and not the own one if there is another."""
    free = tuple(name for name, lamp in sorted(lamps.items()) if lamp.free and name != own)
    return Choice(free or (own,), float(len(free)), 0.0, 5.0, True)


class Robot:
    """One robot: kernel, script, and what its lamp did."""

    def __init__(self, swarm: LitSwarm, name: str) -> None:
        self.swarm, self.name = swarm, name
        self.script = LitScript(swarm, name)
        self.motors = Motors(self.script)
        self.agent: Agent | None = Agent(swarm.fleet, name, CALIBRATION, incarnation=swarm.now_ns)
        self.post: list[tuple[int, Heard]] = []  # when it comes, what
        self.light: tuple[float, tuple[int, int]] = (0.0, (0, 0))
        self.altered_ns: list[int] = []
        self.down_until_ns = self.off_until_ns = 0
        self.began_ns = self.ended_ns = 0
        self.outputs: Outputs | None = None

    def step(self) -> None:
        now_ns, swarm = self.swarm.now_ns, self.swarm
        if self.agent is None:
            if now_ns < self.down_until_ns:
                return
            self.agent, self.post, self.script.waiting = Agent(swarm.fleet, self.name, CALIBRATION, now_ns), [], []
        telemetry, _ = self.motors.drain()
        if now_ns < self.off_until_ns:
            telemetry = tuple(replace(frame, armed=False) for frame in telemetry)
        due = [heard for at_ns, heard in self.post if at_ns <= now_ns]
        self.post = [each for each in self.post if each[0] > now_ns]
        sightings = tuple(self.script.drain())
        if any(s.sweep and s.index == self.script.last for s in sightings):
            self.ended_ns = now_ns
        heard = tuple(replace(each, arrived_ns=now_ns) for each in due)
        outputs = self.outputs = self.agent.step(
            Inputs(telemetry=tuple(telemetry), sightings=sightings, heard=heard), now_ns
        )
        self._act(outputs, now_ns)
        if outputs.outcome and outputs.outcome.x_m is not None:
            swarm.kept.append(self._swept(outputs))
        elif outputs.outcome:
            swarm.rejected.append(outputs.outcome.rejected)

    def _act(self, outputs: Outputs, now_ns: int) -> None:
        set_point = outputs.set_point
        self.motors.send(set_point, now_ns)
        light = set_point.light, set_point.servos_us[2:]
        if light != self.light and (light[0] or self.light[0]):
            self.altered_ns.append(now_ns)
        self.light = light
        if outputs.sweep:
            self.script.plan(outputs.sweep)
            self.began_ns = now_ns
            self.burned = tuple(n for n, robot in self.swarm.robots.items() if robot.light[0])
        self.swarm.carry(self.name, outputs)

    def _swept(self, outputs: Outputs) -> Swept:
        assert outputs.outcome and outputs.outcome.lamps is not None
        altered = tuple(
            (name, at_ns)
            for name, robot in self.swarm.robots.items()
            for at_ns in robot.altered_ns
            if self.began_ns - DARK_NS < at_ns <= self.ended_ns
        )
        return Swept(self.name, tuple(outputs.outcome.lamps or ()), altered, self.burned)


class LitSwarm:
    def __init__(self, weather: Weather = CALM, seed: int = 0, robots: int = 3, fleet: Fleet | None = None) -> None:
        self.fleet, self.weather, self.random = fleet or lit_fleet(robots), weather, Random(seed)
        self.now_ns = START_NS
        self.kept: list[Swept] = []
        self.rejected: list[str] = []
        self.robots: dict[str, Robot] = {}
        for name in self.fleet.robot:
            self.robots[name] = Robot(self, name)

    def run(self, seconds: float) -> None:
        with patch("agent.capabilities.light.allocate.allocate", lend_all):
            for _ in range(round(seconds * 1e9) // STEP_NS):
                self.step()

    def step(self) -> None:
        self.now_ns += STEP_NS
        for robot in self.robots.values():
            self._strike(robot)
            robot.step()

    def _strike(self, robot: Robot) -> None:
        step_s = STEP_NS * 1e-9
        if robot.agent is not None and self.random.random() < self.weather.restarts_hz * step_s:
            robot.agent, robot.down_until_ns = None, self.now_ns + 10**9
        if self.random.random() < self.weather.disarmed_hz * step_s:
            robot.off_until_ns = self.now_ns + 1_500_000_000

    def carry(self, src: str, outputs: Outputs) -> None:
        """What a robot says, on its way. The newest two of each kind are kept between two steps, as transport does."""
        lights = tuple(outputs.said(LIGHT))
        for said in (*outputs.says, *lights):
            payload = Heard(
                arrived_ns=self.now_ns, src=src, payload=encode(said), **({"topic": "light"} if said in lights else {})
            )
            if self.random.random() < self.weather.loss:
                continue
            delay = self.random.randint(1, 6) * STEP_NS if self.random.random() < self.weather.late else 0
            self.robots[said.dst].post.append((self.now_ns + delay, payload))
            if self.random.random() < self.weather.twice:
                again_ns = self.now_ns + self.random.randint(1, 10) * STEP_NS
                self.robots[said.dst].post.append((again_ns, payload))


class LitScript(Script):
    """The script's camera, one frame a step in a sweep, which sees the ball while any lamp burns."""

    def __init__(self, swarm: LitSwarm, name: str) -> None:
        super().__init__(swarm.fleet, name, lambda: swarm.now_ns)
        self.swarm = swarm
        self.waiting: list[tuple[int, int, int, str | None]] = []
        self.last = -1

    def plan(self, plan) -> None:
        self.waiting = [(focus, plan.sweep, index, plan.target) for index, focus in enumerate(plan.focus)][1:]
        self.last = len(plan.focus) - 1

    def drain(self) -> list[Sighting]:
        if self.waiting:
            self.idle_ns = self.clock()
            return [self.look(self.clock(), *self.waiting.pop(0))]
        return super().drain()

    def look(self, now_ns: int, focus: int | None, sweep: int, index: int, target: str | None = None) -> Sighting:
        seen = super().look(now_ns, focus, sweep, index, target)
        if any(robot.light[0] for robot in self.swarm.robots.values()):
            return seen
        return replace(seen, found=False, centre_px=None, radius_px=None, clarity=None, area_px=None, score=0.0)
