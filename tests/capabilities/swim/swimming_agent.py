"""An agent in a tank with tags: its camera sees those that it would, its body swims by what the agent asks for."""

from collections import deque

import numpy as np
from msgspec import UNSET

from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Body, Fleet, Navigation, Pose, Robot, Tank, Target
from agent.core.linear_algebra import wrap
from agent.core.ranging.camera_model import Calibration, CameraFit, gimbal_deg
from agent.core.step_io import Flow, Inputs, SeenTags
from agent.robot.step import Agent
from tests.capabilities.swim.planar_tank import Swimmer
from tests.capabilities.swim.tank_with_tags import HALF, MAP, TANK_M, VIEW, project, sight
from tests.known_lens import PLAIN
from tests.sample_messages import telemetry

START_NS, STEP_NS = 10**18, 50_000_000
KEY_NS = 2_000_000_000  # how old a key frame gets
FLOOR_M = np.array([(x, y, 0.0) for x in np.arange(0.0, 3.0, 0.08) for y in np.arange(0.0, 2.0, 0.08)])
WALLS_M = np.array(
    [(x, y, z) for z in np.arange(0.04, 0.6, 0.08) for x in np.arange(0.0, 3.0, 0.08) for y in (0.0, 2.0)]
    + [(x, y, z) for z in np.arange(0.04, 0.6, 0.08) for x in (0.0, 3.0) for y in np.arange(0.0, 2.0, 0.08)]
)
FOLLOWED_PX = 0.17  # as agent/experiments/navigation/swimmers.py has it
FRAME_STEPS, LATE_STEPS = 4, 2  # 5 Hz; what a frame shows is known 0.1 s after its exposure
SLEW_US = 100  # of a servo in a step, as fast as the slowest that the kernel waits for
CAMERA = CameraFit(
    width_px=VIEW.width_px, height_px=480, f_px=VIEW.f_px, cx_px=319.5, cy_px=239.5, ahead_m=VIEW.ahead_m
)
CALIBRATION = Calibration(robot="any", made="2026-01-01", source="test", focus=PLAIN, camera=CAMERA)
POSE = Pose(x_m=1.0, y_m=0.9, yaw_deg=40.0)
DEPTH_M = 0.3
AT_REST = (0.0, 0.0, 0.0)


def robot(name="r1", pose=POSE, **about) -> Robot:
    return Robot(
        listen=f"tcp/127.0.0.1:1740{name[1:]}",
        serial=f"twin:{name}",
        camera=f"twin:{name}",
        pose=pose,
        depth_m=DEPTH_M,
        calibration=f"{name}.toml",
        **about,
    )


def fleet(*, swims=True, **about) -> Fleet:
    """A fleet of one; `about` that: pose, behaviour, look."""
    return Fleet(
        fleet="swim",
        tank=Tank(size_m=TANK_M, surface_m=VIEW.surface_m),
        target={"ball": Target(radius_m=0.07)},
        body=Body(camera_m=VIEW.arm_m),
        robot={"r1": robot(**about)},
        landmarks=MAP.landmarks,
        navigation=Navigation() if swims else None,
    )


class InTank:
    """One agent, and what is true."""

    def __init__(self, of: Fleet, at=None, seed=None, name="r1", hull=None) -> None:
        """at: x, y and yaw, m and rad; where the file says, if not given. seed: of the errors of what is seen."""
        pose = of.robot[name].pose
        self.fleet, self.agent = of, Agent(of, name, CALIBRATION, incarnation=7)
        self.body = Swimmer.resting(at or (pose.x_m, pose.y_m, np.radians(pose.yaw_deg)), hull)
        self.rng = None if seed is None else np.random.default_rng(seed)
        self.now_ns, self.steps, self.frames = START_NS, 0, 0
        self.armed, self.ladder = True, 0
        self.sees_tags, self.sees_floor = True, False
        self.points_m = FLOOR_M  # that may be followed
        self.key: tuple[int, np.ndarray] | None = None  # exposure, slopes of these points
        self.looked_us, self.turned = np.array([1500.0, 1500.0]), False  # at the last exposure; the gimbal was turning
        self.servos_us = np.array([1500.0, 1500.0])
        self.depth_m = DEPTH_M
        self.coming: deque[tuple[int, SeenTags, Flow]] = deque()
        self.rate_rad_s = lambda body: UNSET  # what its gyro says
        self.inputs, self.outputs, self.state = Inputs(), None, None

    @property
    def swimmer(self):
        return swimmer_of(self.agent.capabilities)

    def expose(self) -> tuple[SeenTags, Flow]:
        """What the camera sees now."""
        pan, tilt = np.radians(gimbal_deg(CAMERA, self.fleet.body, tuple(self.servos_us)))
        theta = (*self.body.at, self.depth_m, 0.0, 0.0, pan, tilt)
        self.frames += 1
        tags = sight(theta, self.rng, most=3) if self.sees_tags else []
        flow = self.flow(theta) if self.sees_floor else Flow(t_ns=self.now_ns, since_ns=self.now_ns, pairs=())
        return SeenTags(t_ns=self.now_ns, frame=self.frames, tags=tuple(tags)), flow

    def flow(self, theta) -> Flow:
        """Points since the key frame; a new one when that is due, or the gimbal has come to rest."""
        slopes, depths = project(theta, self.points_m)
        slopes[(depths < 0.1) | np.any(np.abs(slopes) > HALF, axis=1)] = np.nan
        if self.rng is not None:
            slopes += self.rng.normal(0.0, FOLLOWED_PX / VIEW.f_px, slopes.shape)
        turns = bool(np.any(self.servos_us != self.looked_us))
        if self.key is None or (self.turned and not turns):
            self.key = self.now_ns, slopes
        self.looked_us, self.turned = self.servos_us.copy(), turns
        since_ns, then = self.key
        pairs = np.hstack([then, slopes])
        pairs = pairs[np.isfinite(pairs).all(axis=1)]
        if len(pairs) > 64:
            pairs = pairs[np.linspace(0, len(pairs) - 1, 64).astype(int)]
        if self.now_ns - since_ns >= KEY_NS:
            self.key = self.now_ns, slopes
        return Flow(t_ns=self.now_ns, since_ns=since_ns, pairs=tuple(map(tuple, pairs.tolist())))

    def step(self, step_ns=STEP_NS, more=(), heard=(), pull=AT_REST, orders=()):
        """One step of the agent; more: landmarks beside those that are seen; heard: of neighbours; pull: on the body,
        N, N, N m in the world; orders: of people."""
        self.now_ns += step_ns
        self.steps += 1
        arrived, flows = list(more), []
        while self.coming and self.coming[0][0] <= self.steps:
            _, tags, flow = self.coming.popleft()
            arrived.append(tags)
            flows += [flow] if flow.pairs and self.sees_floor else []
        if self.steps % FRAME_STEPS == 0:
            self.coming.append((self.steps + LATE_STEPS, *self.expose()))
        rate = self.rate_rad_s(self.body)
        told = telemetry(self.now_ns, self.depth_m, armed=self.armed, ladder=self.ladder, rate_rad_s=rate)
        self.inputs = Inputs(
            telemetry=(told,),
            heard=tuple(heard),
            landmarks=tuple(arrived) or UNSET,
            flow=tuple(flows) or UNSET,
            orders=tuple(orders) or UNSET,
        )
        self.outputs = self.agent.step(self.inputs, self.now_ns)
        self.state = self.outputs.state or self.state
        wanted = np.array(self.outputs.set_point.servos_us[:2], float)
        slew_us = SLEW_US * step_ns / STEP_NS
        self.servos_us += np.clip(wanted - self.servos_us, -slew_us, slew_us)
        self.body.swim(self.wrench, step_ns * 1e-9, pull)
        self.body.stay_in(*TANK_M[:2])
        return self.outputs

    def run(self, seconds, step_ns=STEP_NS) -> None:
        for _ in range(round(seconds * 1e9 / step_ns)):
            self.step(step_ns)

    @property
    def wrench(self):
        """What the thrusters are asked for."""
        return (*self.outputs.set_point.force_n, self.outputs.set_point.yaw_moment_nm)

    def off(self, x_m, y_m, yaw_deg) -> tuple[float, float]:
        """How far the body is from there, m and degrees."""
        x, y, psi = self.body.at
        return float(np.hypot(x - x_m, y - y_m)), float(np.degrees(abs(wrap(psi - np.radians(yaw_deg)))))

    def until(self, what, at_most_s):
        """Step until that is so; returns whether it came to be."""
        for _ in range(round(at_most_s * 1e9 / STEP_NS)):
            self.step()
            if what():
                return True
        return False
