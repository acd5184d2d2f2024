"""A robot that swims in the twin's water by its own agent and the real firmware; its tags come from distributions.

Body, thrusters, tether, current, servos and pressure are the twin's, drawn by its seed; frames are not rendered: what
the camera would see of the tags is projected, with the noise that corners have. So minutes take seconds.
"""

from __future__ import annotations

import contextlib
import os
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from msgspec import UNSET
from msgspec.structs import replace

from agent.capabilities.swim.event_ring import Event
from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Behaviour, Fleet, Navigation, Pose, Twin
from agent.core.linear_algebra import wrap
from agent.core.ranging.camera_model import BodyFit
from agent.core.step_io import Inputs, SeenTags, SetPoint
from agent.robot.step import Agent
from hw.stm32.protocol import HostProtocol
from hw.twin.board import Board, interpreter
from hw.twin.dive import Dive, run_in_lock_step
from hw.twin.physics.body import PLAY_DEG, euler_rad
from hw.twin.scene import Current, Pull, Scene
from tests.capabilities.swim.swimming_agent import CALIBRATION, fleet
from tests.capabilities.swim.tank_with_tags import TANK_M, VIEW, sight

STEP_TICKS, FRAME_STEPS, LATE_STEPS = 5, 4, 2  # 20 Hz; 5 frames a second; known 0.1 s after their exposure
SCENE = Scene(name="bench", moored=False, current=Current(gust_m_s=0.005), tether_pull=Pull(force_n=0.05))
MIDDLE = Pose(x_m=TANK_M[0] / 2, y_m=TANK_M[1] / 2, yaw_deg=0.0)


def swimming(seed: int, behaviour: Behaviour | None, pose: Pose = MIDDLE, gyro: bool = False) -> Fleet:
    """A fleet of one."""
    one = fleet(pose=pose, behaviour=behaviour)
    return replace(one, navigation=Navigation(gyro=gyro), twin=Twin(seed=seed))


class DrawnSwimmer:
    """`step` lets 50 ms pass."""

    def __init__(self, of: Fleet, folder: Path, body: BodyFit | None = None) -> None:
        self.dive = Dive(of, ["r1"], 10**9, scene=SCENE)
        # As if calibrated: the last way to a goal is from below, so the camera hangs behind the motor by half the play.
        self.dive.bodies["servo_zero_deg"], self.dive.bodies["servo_gain"] = PLAY_DEG / 2, 1.0
        self.board = Board("r1", folder, self.dive.tare_pa[0], interpreter=interpreter())
        self.dive.boards = [self.board]
        self.protocol = HostProtocol(7)
        self.agent = Agent(of, "r1", replace(CALIBRATION, body=body), incarnation=7)
        self.rng = np.random.default_rng([of.twin.seed, 5])
        self.events: dict[Event, None] = {}
        self.faults: set[str] = set()
        self._coming: deque[tuple[int, SeenTags]] = deque()
        self._port, self._steps = -1, 0
        self._telemetry: list = []
        self._set_point = SetPoint(depth_m=0.3)
        self.protocol.arm()

    def step(self) -> None:
        for _ in range(STEP_TICKS):
            self._converse()
            run_in_lock_step(self.dive, 1)
        self._steps += 1
        arrived = []
        while self._coming and self._coming[0][0] <= self._steps:
            arrived.append(self._coming.popleft()[1])
        if self._steps % FRAME_STEPS == 0:
            self._coming.append((self._steps + LATE_STEPS, self._expose()))
        told = [t for t in self._telemetry if t.t_ns < self.dive.now_ns]
        self._telemetry.clear()
        outputs = self.agent.step(Inputs(telemetry=tuple(told), landmarks=tuple(arrived) or UNSET), self.dive.now_ns)
        self._set_point = outputs.set_point
        if outputs.state is not None:
            self.faults |= set(outputs.state.faults)
        self.events.update(dict.fromkeys(swimmer_of(self.agent.capabilities).localizer.events))
        if self._port >= 0:
            os.write(self._port, self.protocol.set_point(self._set_point, self.dive.now_ns))

    def run(self, seconds: float) -> np.ndarray:
        """True x, y and yaw after each step, (n, 3)."""
        out = []
        for _ in range(round(seconds * 20)):
            self.step()
            out.append(self.pose)
        return np.array(out)

    @property
    def pose(self) -> tuple[float, float, float]:
        state = self.dive.states[0]
        return float(state["position_m"][0]), float(state["position_m"][1]), float(euler_rad(state["quaternion"])[2])

    @property
    def believed(self):
        return swimmer_of(self.agent.capabilities).localizer.at(self.dive.now_ns)

    def off(self, pose: Pose) -> tuple[float, float]:
        """How far the body is from there, m and degrees."""
        x, y, psi = self.pose
        away_rad = wrap(psi - np.radians(pose.yaw_deg))
        return float(np.hypot(x - pose.x_m, y - pose.y_m)), float(np.degrees(abs(away_rad)))

    def _expose(self) -> SeenTags:
        x, y, psi = self.pose
        state = self.dive.states[0]
        roll, pitch, _ = euler_rad(state["quaternion"])
        pan, tilt = np.radians(state["shaft_deg"][:2])
        depth = VIEW.surface_m - float(state["position_m"][2])
        theta = (x, y, psi, depth, roll, pitch, pan, tilt)
        tags = sight(tuple(map(float, theta)), self.rng, most=3)
        return SeenTags(t_ns=self.dive.now_ns, frame=self._steps, tags=tuple(tags))

    def _converse(self) -> None:
        now_ns = self.dive.now_ns
        if self._port < 0:
            with contextlib.suppress(FileNotFoundError):
                self._port = os.open(self.board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                self.protocol.connected()
        if self._port < 0:
            return
        with contextlib.suppress(BlockingIOError):
            self.protocol.receive(os.read(self._port, 65536), now_ns)
        if out := self.protocol.due(now_ns):
            os.write(self._port, out)
        self._telemetry += self.protocol.telemetry
        self.protocol.telemetry.clear()
        self.protocol.lines.clear()

    def close(self) -> None:
        if self._port >= 0:
            os.close(self._port)
        self.board.close()


@contextlib.contextmanager
def drawn(of: Fleet, folder: Path, body: BodyFit | None = None) -> Iterator[DrawnSwimmer]:
    folder.mkdir(parents=True, exist_ok=True)
    one = DrawnSwimmer(of, folder, body)
    try:
        one.board.start()
        yield one
    finally:
        one.close()
