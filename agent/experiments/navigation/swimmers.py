"""The kernel's agents around bodies and drawn cameras, in virtual time: what they ask for is done, what they say heard.

An agent steps every 50 ms. Frames are searched at follow_hz; what one shows is known 0.1 s later. While a sweep moves
the lens, a frame is one position of it, and shows no tags.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from agent.core.codec import encode
from agent.core.config import Fleet
from agent.core.messages import Message, Vector
from agent.core.ranging.camera_model import Calibration
from agent.core.step_io import BlockPeaks, Flow, Heard, Inputs, Outputs, SeenTags, SetPoint, Sighting, SweepPlan
from agent.core.topics import CLAIM, KEYFRAME, LIGHT, NEAR
from agent.experiments.navigation.bodies import START_NS, STEP_NS, Bodies
from agent.experiments.navigation.drawn_ball import FOCUS, BallPath, DrawnBall, DrawnTarget, Pillar, ring
from agent.experiments.navigation.drawn_camera import DrawnCamera
from agent.robot.step import Agent

FRAME_STEPS, LATE_STEPS = 2, 2
NAMES: dict[type[Message], Any] = {row.message: row.name for row in (NEAR, CLAIM, KEYFRAME, LIGHT)}


class Frame(NamedTuple):
    """What is known of one exposure, from that step on."""

    step: int
    tags: SeenTags | None = None
    flow: Flow | None = None
    sighting: Sighting | None = None
    blocks: BlockPeaks | None = None  # of a survey's sweep


class Eyes:
    """One robot's camera, with a ball before it or without; knows which sweep it is at."""

    def __init__(self, fleet: Fleet, name: str, bodies: Bodies, ball_m: Vector | BallPath | None) -> None:
        self.tank = DrawnCamera(fleet, name, bodies.camera(name))
        self.ball: DrawnTarget | None = None if ball_m is None else DrawnBall(fleet, name, bodies.camera(name), ball_m)
        self.hide: tuple[str, ...] = ()  # robots that the ball may be behind
        self.pillars: tuple[Pillar, ...] = ()  # what else it may be behind
        self.covered = False  # it sees nothing at all
        self._plan: SweepPlan | None = None
        self._index = 0
        self.coming: deque[Frame] = deque()

    def sweep(self, plan: SweepPlan) -> None:
        self._plan, self._index = plan, 0
        self.tank.interrupt()

    def expose(self, bodies: Bodies, name: str, step: int, sees_tags: bool) -> None:
        pose, t_ns = bodies.pose(name), bodies.now_ns
        if self.covered:
            self.tank.interrupt()
            dark = None if self.ball is None else self.ball.unseen(t_ns)
            self.coming.append(Frame(step + LATE_STEPS, tags=SeenTags(t_ns=t_ns, frame=0), sighting=dark))
            return
        if self._plan is not None and self.ball is not None:
            self._index += 1
            position = self.ball.sight(pose, t_ns, self._plan, self._index)
            self.coming.append(Frame(step + LATE_STEPS, sighting=position))
            if self._index == len(self._plan.focus) - 1:
                self._plan = None
            return
        tags, flow = self.tank.expose(pose, t_ns)
        before = [*self.pillars, *(ring(bodies.pose(other)) for other in self.hide)]
        sighting = None if self.ball is None else self.ball.sight(pose, t_ns, before=before)
        self.coming.append(Frame(step + LATE_STEPS, tags if sees_tags else None, flow, sighting))

    def arrived(self, step: int) -> list[Frame]:
        found = []
        while self.coming and self.coming[0].step <= step:
            found.append(self.coming.popleft())
        return found


class Swimmers:
    """All robots of a fleet. `inputs` and `outputs` are those of the newest step."""

    def __init__(self, fleet: Fleet, bodies: Bodies, ball_m: Vector | BallPath | None = None) -> None:
        self.fleet, self.bodies, self.steps = fleet, bodies, 0
        self.calibrations = {
            name: Calibration(robot=name, made="2026-01-01", source="drawn", focus=FOCUS, camera=bodies.camera(name))
            for name in fleet.robot
        }
        self.agents = {name: Agent(fleet, name, known, START_NS) for name, known in self.calibrations.items()}
        self.eyes = {name: Eyes(fleet, name, bodies, ball_m) for name in fleet.robot}
        self.lost: Callable[[Message], bool] = lambda letter: False  # on its way
        self.forged: Callable[[Message], Message] = lambda letter: letter  # likewise
        self.sees_tags: Callable[[int], bool] = lambda now_ns: True
        self.follows_points = True  # from frame to frame
        self.inputs: dict[str, Inputs] = {}
        self.outputs: dict[str, Outputs] = {}
        self._wanted = {name: SetPoint(depth_m=robot.depth_m) for name, robot in fleet.robot.items()}
        self._post: dict[str, list[Heard]] = {name: [] for name in fleet.robot}

    @property
    def now_ns(self) -> int:
        return self.bodies.now_ns

    def step(self) -> None:
        """One step of water and cameras, then one of each agent."""
        telemetry = self.bodies.step(self._wanted)
        self.steps += 1
        now_ns, post, self._post = self.now_ns, self._post, {name: [] for name in self.agents}
        for name, agent in self.agents.items():
            eyes = self.eyes[name]
            frames = eyes.arrived(self.steps)
            if self.steps % FRAME_STEPS == 0:
                eyes.expose(self.bodies, name, self.steps, self.sees_tags(now_ns))
            inputs = self.inputs[name] = Inputs(
                telemetry=telemetry[name],
                sightings=tuple(frame.sighting for frame in frames if frame.sighting is not None),
                heard=tuple(post[name]),
                landmarks=tuple(frame.tags for frame in frames if frame.tags is not None) or UNSET,
                flow=tuple(frame.flow for frame in frames if frame.flow is not None and self.follows_points) or UNSET,
                blocks=tuple(frame.blocks for frame in frames if frame.blocks is not None) or UNSET,
            )
            outputs = self.outputs[name] = agent.step(inputs, now_ns)
            self._wanted[name] = outputs.set_point
            if outputs.sweep is not None:
                eyes.sweep(outputs.sweep)
            self._deliver(name, outputs)

    def _deliver(self, src: str, outputs: Outputs) -> None:
        """Whatever an agent says to somebody, of whatever kind, is there with the next step, as from its own key."""
        told = (outputs.near, outputs.claims, outputs.keyframes, outputs.light)
        for letter in (*outputs.says, *(each for said in told for each in said or ())):
            if not self.lost(letter):
                topic, payload = NAMES.get(type(letter), UNSET), encode(self.forged(letter))
                heard = Heard(arrived_ns=self.now_ns, src=src, payload=payload, topic=topic)
                self._post[letter.dst].append(heard)

    def swims(self, name: str) -> bool:
        """Whether it is armed, and does what it is told."""
        swimmer = self.agents[name].swimmer
        return swimmer is not None and swimmer.under_way

    def place(self, name: str) -> tuple[float, float, float]:
        """Where it truly is: x and y (m), yaw (rad)."""
        pose = self.bodies.pose(name)
        x, y, _ = pose.position_m.tolist()
        return x, y, float(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]))

    def path(self, name: str, seconds: float) -> NDArray[np.float64]:
        """Step on for so long: t (s, from now), x, y (m) and yaw (rad) after each step, (n, 4)."""
        rows, before_ns = [], self.now_ns
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.step()
            rows.append(((self.now_ns - before_ns) * 1e-9, *self.place(name)))
        return np.array(rows)

    def until_swims(self, name: str, at_most_s: float) -> bool:
        """Step on until it is armed, and has found itself."""
        for _ in range(round(at_most_s * 1e9 / STEP_NS)):
            self.step()
            if self.swims(name):
                return True
        return False
