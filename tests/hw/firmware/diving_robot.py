"""One robot under way in the twin's tank: real firmware, real pty, the driver's conversation, virtual time.

What is asserted about it is the twin's truth, not what the robot says of itself.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np

from agent.core.config import Fleet, Pose, Robot, Target, Twin
from agent.core.step_io import SetPoint, Telemetry
from hw.stm32.protocol import HostProtocol
from hw.twin.board import Board, CycleTimes, interpreter
from hw.twin.dive import Dive, run_in_lock_step
from hw.twin.physics.body import matrix
from hw.twin.physics.tank import Gyros
from hw.twin.scene import AnyEvent, Scene

FLEET = Fleet(
    fleet="tank",
    target={"ball": Target(radius_m=0.07)},
    robot={
        "r1": Robot(
            listen="tcp/127.0.0.1:17401",
            serial="twin:r1",
            camera="twin:r1",
            pose=Pose(x_m=0.75, y_m=0.6, yaw_deg=30.0),
            depth_m=0.35,
            calibration="none.toml",
        )
    },
    twin=Twin(seed=5),
)
HOVER = SetPoint(depth_m=0.35, servos_us=(1400, 1600, 1500, 1500), light=0.5)
# What the robot does by itself, hw/README.md, "When things go wrong".
ASCENT_M_S, SURFACED_M, TILTED_DEG = 0.07, 0.10, 45.0
REST_N = 0.01  # a thruster that stops fades with its lag: a second leaves less than this of 10 N


class DivingRobot:
    """`run` is the only thing that lets time pass. The host sends set-points at 20 Hz while `talks`."""

    def __init__(
        self, folder: Path, scene: Scene, times: CycleTimes | None, seed: int = FLEET.twin.seed, imu: bool = False
    ) -> None:
        self.dive = Dive(msgspec.structs.replace(FLEET, twin=Twin(seed=seed)), ["r1"], 0, scene=scene)
        self.dive.gyros = Gyros(seed, ["r1"], imu)
        self.board = Board("r1", folder, self.dive.tare_pa[0], interpreter=interpreter(), times=times)
        self.dive.boards = [self.board]
        self.protocol = HostProtocol(7)
        self.talks = True
        self.loss = 0.0  # share of what is said on the tether, either way
        self._dice = np.random.default_rng(seed)
        self.asks = HOVER
        self.telemetry: list[Telemetry] = []
        self.said: list[str] = []
        self._port = -1

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            self._converse()
            run_in_lock_step(self.dive, 1)

    def until(self, done: Callable[[], bool], seconds: float) -> float:
        """Run until `done`; after how long that was."""
        for tick in range(round(seconds * 100)):
            if done():
                return tick / 100
            self.run(0.01)
        raise AssertionError(f"not within {seconds} s; said {self.said}, newest {self.telemetry[-1:]}")

    def arm(self) -> None:
        """Hovering at depth, level, the crew's hands off."""
        self.protocol.arm()
        self.until(lambda: bool(self.telemetry) and self.telemetry[-1].armed, 10.0)
        self.run(3.0)
        assert abs(self.depth_m - HOVER.depth_m) < 0.01 and self.tilt_deg < 1.0

    def _converse(self) -> None:
        """Be the driver's thread for one tick: open the port if there is one, hear, speak."""
        now_ns = self.dive.now_ns
        if self._port < 0:
            with contextlib.suppress(FileNotFoundError):
                self._port = os.open(self.board.port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
                self.protocol.connected()
        if self._port < 0:
            return
        try:
            with contextlib.suppress(BlockingIOError):
                if not (chunk := os.read(self._port, 65536)):
                    raise OSError("hung up")
                if self._dice.random() >= self.loss:
                    self.protocol.receive(chunk, now_ns)
            out = self.protocol.due(now_ns) if self.talks else b""
            if self.talks and self.dive.ticks % 5 == 0:
                out += self.protocol.set_point(self.asks, now_ns)
            if out and self._dice.random() >= self.loss:
                os.write(self._port, out)
        except OSError:
            self.hang_up()
        self.telemetry += self.protocol.telemetry
        self.said += [line.text for line in self.protocol.lines]
        self.protocol.telemetry.clear()
        self.protocol.lines.clear()

    def hang_up(self) -> None:
        if self._port >= 0:
            os.close(self._port)
            self._port = -1

    # --- the truth ------------------------------------------------------------------------------------------------

    @property
    def depth_m(self) -> float:
        return FLEET.tank.surface_m - float(self.dive.states["position_m"][0, 2])

    @property
    def tilt_deg(self) -> float:
        """Angle between the hull's up and the world's."""
        return float(np.degrees(np.arccos(np.clip(matrix(self.dive.states["quaternion"][0])[2, 2], -1, 1))))

    @property
    def thrust_n(self) -> np.ndarray:
        """(8,) without sign."""
        return np.abs(self.dive.states["thrust_n"][0])

    # --- what the robot says --------------------------------------------------------------------------------------

    @property
    def ladder(self) -> int:
        return self.telemetry[-1].ladder

    @property
    def armed(self) -> bool:
        return self.telemetry[-1].armed

    def heard(self, text: str) -> bool:
        return any(text in line for line in self.said)


@contextlib.contextmanager
def diving_robot(
    folder: Path,
    faults: Sequence[AnyEvent] = (),
    times: CycleTimes | None = None,
    moored: bool = True,
    seed: int = FLEET.twin.seed,
    imu: bool = False,
) -> Iterator[DivingRobot]:
    """A robot held by the crew at 0.35 m, its firmware running, until the end of the block."""
    robot = DivingRobot(folder, Scene(name="tank", moored=moored, event=tuple(faults)), times, seed, imu)
    try:
        robot.board.start()
        yield robot
    finally:
        robot.hang_up()
        robot.board.close()


# A host as a process of its own, python -c HOST PORT: says "armed" when it is, and breaks at SIGUSR1.
HOST = """
import signal, sys, time
from agent.clock.clock import SystemClock
from agent.core.step_io import SetPoint
from hw.stm32.driver import Stm32

def break_off(*_):
    raise RuntimeError("the agent is broken")

signal.signal(signal.SIGUSR1, break_off)
with Stm32(sys.argv[1], SystemClock()) as board:
    board.arm()
    while True:
        board.send(SetPoint(depth_m=0.35, servos_us=(1400, 1600, 1500, 1500), light=0.5), time.time_ns())
        telemetry, _ = board.drain()
        if telemetry and telemetry[-1].armed:
            print("armed", flush=True)
        time.sleep(0.02)
"""
