"""Processor time of whole steps: one robot of each of five fleets among neighbours that lie in sequences.

A step that takes long is made again, from the same state with the same inputs, and counts by the quickest of its runs:
what the machine did meanwhile is not the step's. No step may take more than SLOW_S, none may break, and nothing that
neighbours say may make a robot hold more than a fixed number of things.
"""

from __future__ import annotations

import resource
import time
from collections import deque
from collections.abc import Callable, Iterator
from random import Random
from statistics import median
from typing import Any, NamedTuple

from msgspec.structs import replace

from agent.capabilities.survey.coverage_map import STARTS, SUMS
from agent.capabilities.survey.survey import surveyor_of
from agent.core.capability_messages import MOST_NUMBER
from agent.core.config import Fleet
from agent.core.step_io import Heard, Inputs, Outputs
from agent.core.step_transaction import Savepoint
from agent.core.topics import CLAIM, KEYFRAME, LIGHT, NEAR, Topic
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.reconstruction import coverage
from agent.experiments.reconstruction.coverage import draw_scene
from agent.experiments.reconstruction.survey import SurveyEyes, WideBodies, swimming_fleet
from agent.robot.step import Agent
from tests.capabilities.light.dark_survey import DarkSurvey
from tests.capabilities.light.lit_swarm import LitSwarm
from tests.fuzz.kernel.invariants import Broken
from tests.fuzz.kernel.mouths import Mouth
from tests.fuzz.kernel.sizes import largest
from tests.fuzz.kernel.swarm import private_key

SLOW_S = 0.05  # of the processor: as long as there is from one step to the next
LOOK_S = 0.02  # what took longer is made again
RUNS = 5
EACH = 2  # messages of a neighbour on a topic that the transport gives to a step
VICTIM = "r1"
SIZES_EVERY = 500  # steps
LONGEST = 3000  # entries of a container beside those that the grid of a map bounds


class Worst(NamedTuple):
    """The slowest step of a fleet, by its quickest run."""

    least_s: float = 0.0
    median_s: float = 0.0
    step: int = 0
    heard: int = 0


class Stage:
    """One robot of a fleet, alone with its devices. `advance` makes one step of it."""

    def __init__(self, fleet: Fleet, agent: Agent, advance: Callable[[], object], topics: tuple[Topic, ...]) -> None:
        self.fleet, self.agent, self.advance, self.topics = fleet, agent, advance, topics


def moored(keys: bool) -> Stage:
    """A survey of five robots that hang."""
    fleet = coverage.fleet_of()
    fleet = replace(fleet, access=replace(fleet.access, keys="keys")) if keys else fleet
    scene = draw_scene((coverage.SIZE_M[0], coverage.SIZE_M[1], coverage.SURFACE_M), 1)
    world = coverage.World(fleet, scene, 1, False, 0.0)
    agent = world.agents[VICTIM]
    world.agents = {VICTIM: agent}
    return Stage(fleet, agent, world.step, (CLAIM, KEYFRAME))


def swimming(world: Swimmers, topics: tuple[Topic, ...]) -> Stage:
    agent = world.agents[VICTIM]
    world.agents, world._deliver = {VICTIM: agent}, lambda src, outputs: None  # type: ignore[method-assign]
    return Stage(world.fleet, agent, lambda: Swimmers.step(world), topics)


def by_day() -> Stage:
    """A survey of three robots that swim."""
    fleet = swimming_fleet(1)
    bodies = WideBodies(fleet)
    world = Swimmers(fleet, bodies)
    scene = draw_scene((*fleet.tank.size_m[:2], fleet.tank.surface_m), 1, 4)
    world.eyes = {name: SurveyEyes(fleet, name, bodies, scene) for name in fleet.robot}
    return swimming(world, (CLAIM, KEYFRAME, NEAR))


def lit() -> Stage:
    """Three robots that hang in the dark around a ball."""
    swarm = LitSwarm()
    robot = swarm.robots[VICTIM]
    swarm.robots, swarm.carry = {VICTIM: robot}, lambda src, outputs: None  # type: ignore[method-assign]
    assert robot.agent is not None
    return Stage(swarm.fleet, robot.agent, swarm.step, (LIGHT,))


STAGES: dict[str, Callable[[], Stage]] = {
    "survey": lambda: moored(False),
    "survey-keys": lambda: moored(True),
    "survey-swims": by_day,
    "survey-night": lambda: swimming(DarkSurvey(1), (CLAIM, KEYFRAME, LIGHT, NEAR)),
    "night": lit,
}


class Watched:
    """A stage with liars, and what its steps cost."""

    def __init__(self, name: str, seed: int, timed: bool = True) -> None:
        self.name, self.timed = name, timed
        self.stage = STAGES[name]()
        fleet, rng = self.stage.fleet, Random(f"{seed}/{name}")
        neighbours = fleet.robot[VICTIM].neighbours
        self.mouths = [Mouth(fleet, each, VICTIM, self.stage.topics, Random(rng.random())) for each in neighbours]
        self.worst, self.messages, self.steps, self.sums = Worst(), 0, 0, 0
        self.broken: deque[Broken] = deque()
        self._sound, self._rng = self.stage.agent.step, rng
        self.stage.agent.step = self._step  # type: ignore[method-assign]
        self._keys = None if fleet.access.keys is None else {n: public(n) for n in fleet.robot}
        surveyor = surveyor_of(self.stage.agent.capabilities)
        self._known = None if surveyor is None else surveyor.known
        if self._known is not None:
            self._known_sum, self._known._sum = self._known._sum, self._summed  # type: ignore[method-assign]

    def run(self, messages: int, until_s: float | None = None) -> Iterator[Broken]:
        """Tell it at least so many; what was broken."""
        last = self.messages + messages
        while self.messages < last and (until_s is None or time.monotonic() < until_s):
            self.stage.advance()
            yield from self.broken
            self.broken.clear()

    def told(self) -> str:
        """How slow its slowest step is, and what this process holds by now."""
        least_s, median_s, step, heard = self.worst
        held_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        took = f"{1e3 * least_s:.1f} ms at best, {1e3 * median_s:.1f} in the middle of {RUNS} runs"
        return f"{self.name}: slowest step of {self.steps}: {took}, step {step} with {heard} messages; {held_mb:.0f} MB"

    def _step(self, inputs: Inputs, now_ns: int) -> Outputs:
        lies = [
            Heard(arrived_ns=now_ns, src=mouth.me, topic=topic, payload=payload)
            for mouth in self._rng.sample(self.mouths, len(self.mouths))
            for topic, payload in mouth.lies(self._rng.choice((0, 1, EACH, EACH)), now_ns)
        ]
        inputs = replace(inputs, heard=(*inputs.heard, *lies))
        if self._keys is not None:
            inputs, self._keys = replace(inputs, keys=self._keys), None
        self.messages += len(lies)
        self.steps += 1
        self.sums = 0
        outputs = self._run(inputs, now_ns)
        for light in outputs.said(LIGHT):
            next(mouth for mouth in self.mouths if mouth.me == light.dst).overhear(light)
        self._judge(now_ns)
        return outputs

    def _run(self, inputs: Inputs, now_ns: int) -> Outputs:
        before = Savepoint(self.stage.agent) if self.timed else None
        taken_s, outputs = self._timed(inputs, now_ns)
        if before is None or taken_s <= max(LOOK_S, self.worst.least_s):
            return outputs
        runs = [taken_s]
        for _ in range(RUNS - 1):
            before.restore()
            self.sums = 0
            taken_s, outputs = self._timed(inputs, now_ns)
            runs.append(taken_s)
        if min(runs) > self.worst.least_s:
            self.worst = Worst(min(runs), median(runs), self.steps, len(inputs.heard))
            if min(runs) > SLOW_S:
                told = f"{1e3 * min(runs):.1f} ms, step {self.steps}, which heard {len(inputs.heard)} messages"
                self.broken.append(Broken(f"{self.name}: slow", told))
        return outputs

    def _timed(self, inputs: Inputs, now_ns: int) -> tuple[float, Outputs]:
        started_s = time.thread_time()
        outputs = self._sound(inputs, now_ns)
        return time.thread_time() - started_s, outputs

    def _judge(self, now_ns: int) -> None:
        if (fault := self.stage.agent.transaction.fault(now_ns)) is not None:
            self.broken.append(Broken(f"{self.name}: {fault:.80}", f"step {self.steps}"))
        if self.sums > SUMS + 1:  # one of its own
            self.broken.append(Broken(f"{self.name}: sums", f"{self.sums} keyframes in step {self.steps}"))
        if self.steps % SIZES_EVERY == 0:
            length, where = largest(self.stage.agent)
            if length > self._longest():
                self.broken.append(Broken(f"{self.name}: size", f"{where} has {length} parts"))

    def _longest(self) -> int:
        """Of any container that may be."""
        if self._known is None:
            return LONGEST
        nx, ny, nz = self._known.grid.shape
        starts = STARTS * len(self.stage.fleet.robot)
        return max(LONGEST, nx * ny * nz, starts * MOST_NUMBER)

    def _summed(self, *what: Any) -> None:
        self.sums += 1
        self._known_sum(*what)


def public(name: str) -> bytes:
    return private_key(name).public_key().public_bytes_raw()
