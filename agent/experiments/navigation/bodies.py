"""Robots in the basin, the twin's or planar ones, as a loop around the kernel needs them: one shape for both."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from typing import Protocol

import msgspec
import numpy as np

from agent.core.config import Body, Fleet
from agent.core.ranging.camera_model import CameraFit, gimbal_deg
from agent.core.step_io import SetPoint, Telemetry
from agent.experiments.board_host import Host
from agent.experiments.navigation.basin import DEPTH_M, TANK
from agent.experiments.navigation.planar_body import PlanarBody, drawn_hull
from agent.process.command import Failed, temporary_folder
from hw.twin.devices.board import Board, interpreter
from hw.twin.dive import Dive
from hw.twin.history import RobotPose
from hw.twin.pace import run_in_lock_step
from hw.twin.physics.servo import PLAY_DEG
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import Pull, Scene, generator

START_NS = 10**18
STEP_NS = 50_000_000  # of the agents
SLEW_US = 100  # of a planar robot's servos in a step: as fast as the slowest that the kernel waits for
PULL = Pull(force_n=0.05)  # of the tethers, in all cases: the issue is how well a robot holds against it

# The twin's camera imx519_640 in water; gimbals as they truly are, for no bench has calibrated these robots.
CAMERA = CameraFit(width_px=640, height_px=480, f_px=1184.0, cx_px=319.5, cy_px=239.5, noise_deg=0.02)


class Bodies(Protocol):
    """All robots of a fleet."""

    @property
    def now_ns(self) -> int:
        """The robots' clock."""

    def step(self, wanted: Mapping[str, SetPoint]) -> dict[str, tuple[Telemetry, ...]]:
        """Move on by STEP_NS under these set-points; what each module said meanwhile."""

    def pose(self, name: str) -> RobotPose:
        """Where it truly is now."""

    def camera(self, name: str) -> CameraFit:
        """What a perfect calibration would say."""


class PlanarBodies:
    """In the plane, level and at depth; each body's constants are drawn. Tethers pull as the twin's do."""

    def __init__(self, fleet: Fleet, *, pull: Pull = PULL) -> None:
        self.now_ns = START_NS
        self.armed = True  # False: the crew holds them, and motors may not turn
        self._mounting: Body = fleet.body
        self._bodies, self._servos_us, self._pulls, self._rngs = {}, {}, {}, {}
        self._keeps = float(np.exp(-STEP_NS * 1e-9 / pull.correlation_s))
        self._sigma_n = pull.force_n / np.sqrt(2.0)
        for name, robot in fleet.robot.items():
            rng = self._rngs[name] = generator(fleet.twin.seed, name, "planar")
            at = robot.pose.x_m, robot.pose.y_m, np.radians(robot.pose.yaw_deg)
            self._bodies[name] = PlanarBody.resting(at, drawn_hull(rng))
            self._servos_us[name] = np.full(2, fleet.body.servo_centre_us)
            self._pulls[name] = rng.normal(0.0, self._sigma_n, 2)

    def step(self, wanted: Mapping[str, SetPoint]) -> dict[str, tuple[Telemetry, ...]]:
        self.now_ns += STEP_NS
        for name, to in wanted.items():
            pull = self._pulls[name]
            fresh = self._rngs[name].normal(0.0, self._sigma_n, 2)
            self._pulls[name] = self._keeps * pull + np.sqrt(1.0 - self._keeps**2) * fresh
            if self.armed:
                self._bodies[name].swim((*to.force_n, to.yaw_moment_nm), STEP_NS * 1e-9, (pull[0], pull[1], 0.0))
                self._bodies[name].stay_in(*TANK.size_m[:2])
            way = np.array(to.servos_us[:2]) - self._servos_us[name]
            self._servos_us[name] += np.clip(way, -SLEW_US, SLEW_US)
        return {name: (at_rest(self.now_ns, self.armed),) for name in self._bodies}

    def pose(self, name: str) -> RobotPose:
        x, y, psi = self._bodies[name].at
        c, s = np.cos(psi), np.sin(psi)
        pan_us, tilt_us = self._servos_us[name]
        pan, tilt = gimbal_deg(CAMERA, self._mounting, (pan_us, tilt_us))
        rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return RobotPose(np.array([x, y, TANK.surface_m - DEPTH_M]), rotation, pan, tilt)

    def camera(self, name: str) -> CameraFit:
        return CAMERA


class TwinBodies:
    """The twin's bodies with six degrees of freedom, each under the board's own firmware in a process of its own."""

    def __init__(self, dive: Dive, hosts: Mapping[str, Host]) -> None:
        self._dive, self._hosts = dive, hosts

    @property
    def now_ns(self) -> int:
        return self._dive.now_ns

    def step(self, wanted: Mapping[str, SetPoint]) -> dict[str, tuple[Telemetry, ...]]:
        """Raises Failed where a firmware hangs."""
        for host in self._hosts.values():
            host.heard.clear()
        for _ in range(STEP_NS // TICK_NS):
            for name, to in wanted.items():
                self._hosts[name].exchange(to, self._dive)
            try:
                run_in_lock_step(self._dive, 1)
            except TimeoutError as error:
                raise Failed(str(error)) from None
        return {name: tuple(host.heard) for name, host in self._hosts.items()}

    def pose(self, name: str) -> RobotPose:
        return self._dive.history.at(self._dive.now_ns)[self._dive.robots.index(name)]

    def camera(self, name: str) -> CameraFit:
        """With the servos' own gains and zeros, behind the motor by half of their play: they come from below."""
        body = self._dive.bodies[self._dive.robots.index(name)]
        pan, tilt = (body["servo_zero_deg"][k] - PLAY_DEG / 2 for k in (0, 1))
        return msgspec.structs.replace(
            CAMERA,
            pan_zero_deg=float(pan),
            tilt_zero_deg=float(tilt),
            pan_gain=float(body["servo_gain"][0]),
            tilt_gain=float(body["servo_gain"][1]),
        )


@contextlib.contextmanager
def twin_bodies(fleet: Fleet, *, pull: Pull = PULL) -> Iterator[TwinBodies]:
    """Boot them; they swim freely once they are armed."""
    names = list(fleet.robot)
    dive = Dive(fleet, names, START_NS, scene=Scene(name="basin", moored=False, tether_pull=pull))
    with temporary_folder() as folder, contextlib.ExitStack() as stack:
        dive.boards = [
            Board(name, folder, tare_pa, interpreter=interpreter())
            for name, tare_pa in zip(names, dive.tare_pa, strict=True)
        ]
        for board in dive.boards:
            stack.callback(board.close)
            board.start()
        yield TwinBodies(dive, {board.robot: stack.enter_context(Host(board)) for board in dive.boards})


def at_rest(t_ns: int, armed: bool) -> Telemetry:
    """A module whose robot is level and at depth."""
    return Telemetry(
        t_ns=t_ns,
        board_us=0,
        depth_m=DEPTH_M,
        roll_deg=0.0,
        pitch_deg=0.0,
        sensor_depth_m=(DEPTH_M,) * 4,
        pulses_us=(1500,) * 8,
        servos_us=(1500,) * 4,
        battery_v=14.0,
        armed=armed,
        ladder=0,
        flags=0,
        loop_us=0,
    )
