"""One robot's real mind in its real loop, stepped by hand, and what stands in for those of its parts that are idle."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from msgspec.structs import replace

from agent.clock.clock import Clock, StandingClock
from agent.core.codec import decode
from agent.core.config import Fleet
from agent.core.messages import State
from agent.core.ranging.camera_model import Calibration
from agent.core.ranging.focus import lens_position
from agent.core.step_io import Outputs, SetPoint
from agent.process.agent_process import STEP_NS, Runtime
from agent.robot.step import Agent
from hw.camera.camera import Camera, CameraGone, Frame, Image, Roi
from replay.check.reexecute import STEP_BYTES
from tests.golden.frames import CENTRE_M
from tests.golden.make import CASES, START_NS, fleet_of
from tests.known_lens import FITTED
from tests.network.conftest import unused_port
from tests.network.scripted_agent import CALIBRATION
from tests.perception.painted import PX_PER_POSITION, ball_frame
from tests.perception.scripted_camera import ScriptedCamera

MOST_STEPS = 600  # half a minute of the robot's time
PAUSE_S = 0.008  # of the wall, between two steps: a message on loopback arrives sooner
FRAME_S = 0.03


class SteppedClock(StandingClock):
    """Goes on by a step where it is told to: what comes when, is the same in each run."""

    def __init__(self) -> None:
        super().__init__(START_NS)

    def step(self) -> None:
        self._at_ns += STEP_NS


class Blind:
    """Eyes that see nothing."""

    def drain(self) -> tuple[()]:
        return ()

    def views(self) -> tuple[()]:
        return ()

    def plan(self, plan: Any) -> None: ...
    def rest(self, lens_position: int | None) -> None: ...


class Adrift:
    """A control module that says nothing."""

    def drain(self) -> tuple[tuple[()], tuple[()]]:
        return (), ()

    def send(self, set_point: SetPoint, now_ns: int) -> None: ...


class Alone:
    """A network without anybody."""

    def drain(self) -> tuple[tuple[()], tuple[()]]:
        return (), ()

    def orders(self) -> tuple[()]:
        return ()

    def answer(self, answers: Any) -> None: ...
    def say(self, message: Any) -> None: ...
    def show(self, message: Any) -> None: ...


class Robot:
    """`parts` as Runtime takes them; the others are idle. A step that breaks raises."""

    outputs: Outputs  # of the newest step

    def __init__(
        self, fleet: Fleet, clock: Clock, name: str = "r1", calibration: Calibration = CALIBRATION, **parts: Any
    ) -> None:
        self.clock = clock
        self.agent = Agent(fleet, name, calibration, clock.now_ns())
        idle = {"eyes": Blind(), "module": Adrift(), "network": Alone()}
        self.loop = Runtime(name, self.agent, record=self._record, clock=clock, **{**idle, **parts})
        self._steps = 0

    def step(self) -> None:
        """Once around the loop, a step of the clock later than the last one."""
        if isinstance(self.clock, SteppedClock):
            self.clock.step()
            time.sleep(PAUSE_S)
        else:
            time.sleep(STEP_NS * 1e-9)
        self.loop.step(self._steps)
        self._steps += 1

    def until(self, done: Callable[[], bool]) -> None:
        for _ in range(MOST_STEPS):
            self.step()
            if done():
                return
        raise AssertionError(f"not within {MOST_STEPS} steps: {self.outputs}")

    @property
    def state(self) -> State | None:
        """What the newest step shows."""
        return self.outputs.state

    def shows(self, what: str) -> bool:
        """Whether the newest step shows that the robot is blind, told, or sees."""
        return self.state is not None and self.state.knows == what

    @property
    def t(self) -> int:
        """The iteration that its target is at."""
        return self.agent.measuring.current.estimator.t

    def _record(self, number: int, now_ns: int, inputs: bytes, outputs: bytes | None) -> None:
        if outputs is not None:
            self.outputs = decode(outputs, Outputs, limit=STEP_BYTES)


class BallCamera(ScriptedCamera):
    """A painted ball, as sharp as the lens is near its place. `open` raises until the camera is `plugged` in."""

    def __init__(self) -> None:
        blurs = {round(self._blur_px(lens)) for lens in range(FITTED.lowest, FITTED.highest)}
        drawn = {blur: ball_frame(CENTRE_M, blur) for blur in blurs}  # beforehand: drawing takes long
        super().__init__(images=lambda blur_px: drawn[round(blur_px)])
        self.plugged = False

    def open(self) -> Camera:
        if not self.plugged:
            raise CameraGone("no camera there; plug it in")
        return self

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = 1.0) -> Frame:
        time.sleep(FRAME_S)
        self.seq += 1
        part = roi or Roi(0, 0, *self.size)
        image: Image = self.images(self._blur_px(self.lens_position))
        image = image[part.y : part.y + part.height, part.x : part.x + part.width]
        return Frame(time.monotonic_ns(), self.seq, image, part)

    def _blur_px(self, lens: int) -> float:
        lens = min(max(lens, FITTED.lowest), FITTED.highest - 1)
        return PX_PER_POSITION * abs(lens - lens_position(FITTED, CENTRE_M[2] - 0.07))


def small_fleet(protocol: str = "evidence") -> Fleet:
    """Two robots of the tank on free ports of this machine. r1 looks at the ball, r2 does not."""
    fleet = fleet_of(CASES["three"])
    robots = {
        name: replace(fleet.robot[name], neighbours=(other,), listen=f"tcp/127.0.0.1:{unused_port()}")
        for name, other in (("r1", "r2"), ("r2", "r1"))
    }
    return replace(fleet, robot=robots, estimation=replace(fleet.estimation, protocol=protocol))
