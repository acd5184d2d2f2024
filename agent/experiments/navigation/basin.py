"""The basin of the experiment on navigation, and the bodies that swim in it: the twin's or planar ones.

The basin is 3 x 2 m, with tags of 8 cm every 25 cm on the floor and in two rows on each wall.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from agent.capabilities.swim.pose_filter import Hull
from agent.core.config import (
    Behaviour,
    Body,
    Face,
    Fleet,
    Landmarks,
    Look,
    Navigation,
    Pose,
    Robot,
    Tag,
    Tank,
    Target,
    Twin,
)
from agent.core.messages import Vector
from agent.core.ranging.camera_model import CameraFit, gimbal_deg
from agent.core.step_io import SetPoint, Telemetry
from agent.experiments.ball_measurements import Host, hosts_of
from agent.process.command import Failed
from hw.twin.dive import Dive, RobotPose, run_in_lock_step
from hw.twin.physics.body import PLAY_DEG
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import Pull, Scene, generator

TANK = Tank(size_m=(3.0, 2.0, 0.8), surface_m=0.6)
TAG_M, PITCH_M, ROWS_M = 0.08, 0.25, (0.15, 0.40)  # rows: heights on the walls
DEPTH_M = 0.30
FLOOR_LOOK = Look(tilt_deg=-40.0)  # at the floor half a metre ahead: a whole tag nearly always, and points to follow
BALL = Target(radius_m=0.07)
TURN_S = 3.0  # for which what swims keeps a course, by its fleet file


def tags() -> tuple[Tag, ...]:
    """All of them, as surveyed. Each is turned otherwise than those beside it."""
    length_m, breadth_m, _ = TANK.size_m
    along_x, along_y = (np.arange(PITCH_M, side_m - 0.1, PITCH_M) for side_m in (length_m, breadth_m))
    places: list[tuple[Face, Vector]] = [("floor", (float(x), float(y), 0.0)) for x in along_x for y in along_y]
    for z in ROWS_M:
        places += [(face, (float(x), at, z)) for face, at in _faces("y0", "y1", breadth_m) for x in along_x]
        places += [(face, (at, float(y), z)) for face, at in _faces("x0", "x1", length_m) for y in along_y]
    return tuple(
        Tag(id=k, face=face, position_m=at_m, turn_deg=15.0 * (k % 5)) for k, (face, at_m) in enumerate(places)
    )


def _faces(near: Face, far: Face, at_m: float) -> tuple[tuple[Face, float], tuple[Face, float]]:
    return (near, 0.0), (far, at_m)


def fleet(robots: Mapping[str, Robot], seed: int, ball: Target = BALL) -> Fleet:
    """Robots in the basin, and a ball; seed: of the twin's world."""
    return Fleet(
        fleet="navigation",
        tank=TANK,
        target={"ball": ball},
        landmarks=Landmarks(size_m=TAG_M, tag=tags()),
        navigation=Navigation(),
        robot=dict(robots),
        twin=Twin(seed=seed, scene="swim"),
    )


def robot(
    name: str, pose: Pose, behaviour: Behaviour | None = None, look: Look = FLOOR_LOOK, neighbours: tuple[str, ...] = ()
) -> Robot:
    """One of them; its devices are never opened."""
    return Robot(
        neighbours=neighbours,
        listen=f"tcp/127.0.0.1:{17400 + int(name[1:])}",
        serial=f"twin:{name}",
        camera=f"twin:{name}",
        pose=pose,
        depth_m=DEPTH_M,
        look=look,
        calibration=f"{name}.toml",
        behaviour=behaviour,
    )


def linked(
    poses: Sequence[Pose],
    seed: int,
    look: Look = FLOOR_LOOK,
    does: Sequence[Behaviour | None] | None = None,
    ball: Target = BALL,
) -> Fleet:
    """Robots r1, r2 ... at those poses, each a neighbour of all; does: what each is told."""
    names = [f"r{k + 1}" for k in range(len(poses))]
    robots = {
        name: robot(name, pose, what, look, tuple(other for other in names if other != name))
        for name, pose, what in zip(names, poses, does or [None] * len(poses), strict=True)
    }
    return fleet(robots, seed, ball)


# --- a body in the plane: the kernel's own form of the equations, with constants of its own ---

Array = NDArray[np.float64]

STEP_S = 0.005
RING_M = 0.17  # from the centre to the outside of the thruster ring
WITHIN = {"drag": 2.0, "turn": 2.0, "mass": 1.15}  # a drawn body's constants are these times larger or smaller at most


@dataclass
class PlanarBody:
    """A body, in steps of STEP_S; its constants are its own, and the kernel need not know them."""

    at: Array  # x, y (m), psi (rad)
    hull: Hull
    speed: Array  # in the world: m/s, m/s, rad/s
    force: Array  # acting, body frame: N ahead, N left, N m

    @classmethod
    def resting(cls, at: ArrayLike, hull: Hull | None = None) -> PlanarBody:
        return cls(np.array(at, float), hull or Hull(), np.zeros(3), np.zeros(3))

    def swim(self, asked_for: ArrayLike, seconds: float, pull: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Move on. asked_for: N, N, N m in the body's frame; pull: from outside, N, N, N m in the world."""
        hull = self.hull
        for _ in range(round(seconds / STEP_S)):
            self.force += (np.asarray(asked_for) - self.force) * (STEP_S / hull.lag_s)
            c, s = np.cos(self.at[2]), np.sin(self.at[2])
            ahead, left, moment = self.force
            push = np.array([c * ahead - s * left, s * ahead + c * left, moment])
            v = np.hypot(self.speed[0], self.speed[1])
            linear = hull.drag + hull.drag2 * v
            drag = [linear, linear, hull.turn_drag + hull.turn_drag2 * abs(self.speed[2])]
            inertia = [hull.mass_kg, hull.mass_kg, hull.inertia_kgm2]
            self.speed += STEP_S * (push + pull - drag * self.speed) / inertia
            self.at += STEP_S * self.speed

    def stay_in(self, length_m: float, breadth_m: float) -> None:
        """A wall of the tank stops the thruster ring that has come to it."""
        for k, side_m in enumerate((length_m, breadth_m)):
            if not RING_M <= self.at[k] <= side_m - RING_M:
                self.at[k] = np.clip(self.at[k], RING_M, side_m - RING_M)
                self.speed[k] = 0.0


def drawn_hull(rng: np.random.Generator) -> Hull:
    """A body that differs from what the kernel believes by as much as the twin's do."""
    usual = Hull()
    about = {name: factor ** rng.uniform(-1.0, 1.0, 2) for name, factor in WITHIN.items()}
    return Hull(
        mass_kg=usual.mass_kg * about["mass"][0],
        drag=usual.drag * about["drag"][0],
        drag2=usual.drag2 * about["drag"][1],
        inertia_kgm2=usual.inertia_kgm2 * about["mass"][1],
        turn_drag=usual.turn_drag * about["turn"][0],
        turn_drag2=usual.turn_drag2 * about["turn"][1],
        lag_s=usual.lag_s,
    )


# --- all bodies of a fleet, as a loop around the kernel needs them ---

START_NS = 10**18
STEP_NS = 50_000_000  # of the agents
SLEW_US = 100  # of a planar robot's servos in a step: as fast as the slowest that the kernel waits for
PULL = Pull(force_n=0.05)  # of the tethers, in all cases: the issue is how well a robot holds against it

# The twin's camera imx519_640 in water; gimbals as they truly are, for no bench has calibrated these robots.
CAMERA = CameraFit(width_px=640, height_px=480, f_px=1184.0, cx_px=319.5, cy_px=239.5, noise_deg=0.02)


class Bodies(Protocol):
    """All robots of a fleet; the same interface for the twin's bodies and for planar ones."""

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
def twin_bodies(fleet: Fleet) -> Iterator[TwinBodies]:
    """Boot them; they swim freely once they are armed."""
    dive = Dive(fleet, list(fleet.robot), START_NS, scene=Scene(name="basin", moored=False, tether_pull=PULL))
    with hosts_of(dive) as hosts:
        yield TwinBodies(dive, hosts)


def at_rest(t_ns: int, armed: bool, depth_m: float = DEPTH_M) -> Telemetry:
    """A module whose robot is level and at depth."""
    return Telemetry(
        t_ns=t_ns,
        board_us=0,
        depth_m=depth_m,
        roll_deg=0.0,
        pitch_deg=0.0,
        sensor_depth_m=(depth_m,) * 4,
        pulses_us=(1500,) * 8,
        servos_us=(1500,) * 4,
        battery_v=14.0,
        armed=armed,
        ladder=0,
        flags=0,
        loop_us=0,
    )
