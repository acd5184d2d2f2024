"""The kernel's agents around bodies and drawn cameras, in virtual time: what they ask for is done, what they say heard.

Frames are drawn, never rendered: first a camera that sees tags and points, then a target before it, then all robots of
a fleet. An agent steps every 50 ms. Frames are searched at follow_hz; what one shows
is known 0.1 s later. While a sweep moves the lens, a frame is one position of it, and shows no tags.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET, UnsetType
from numpy.typing import NDArray

from agent.capabilities.swim.projection import BENT_PX, EDGE_AT, EDGE_PX, OFFSET_PX, STRETCH
from agent.capabilities.swim.swim import swimmer_of
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.codec import encode
from agent.core.config import Fleet
from agent.core.linear_algebra import full
from agent.core.messages import Message, Vector
from agent.core.ranging.camera_model import Calibration, CameraFit, FocusFit, centre_behind_skin_m, pixel
from agent.core.ranging.fix import CENTRE_NOISE_PX, EDGE_NOISE_PX
from agent.core.ranging.focus import as_on_axis, port_share
from agent.core.step_io import (
    BlockPeaks,
    Flow,
    Heard,
    Inputs,
    Outputs,
    SeenTag,
    SeenTags,
    SetPoint,
    Sighting,
    SweepPlan,
)
from agent.core.topics import CLAIM, KEYFRAME, LIGHT, NEAR
from agent.experiments.navigation.basin import RING_M, START_NS, STEP_NS, TANK, Bodies
from agent.perception.flow import MOST, STILL_PX, has_settled, is_due
from agent.perception.tags import module_px
from agent.robot.step import Agent
from hw.twin.camera_device import look
from hw.twin.dive import RobotPose
from hw.twin.scene import generator
from hw.twin.truth import true_tags

# --- drawn camera: tags and points of floor and walls projected ---
# The tags hang where the twin's survey errors put them (hw.twin.truth), the camera looks from where the twin's
# gimbal carries it. Corners err as `projection.tag_noise` says, measured on rendered frames; points that are followed,
# as docs/landmarks.md says. Tags without edges are left out. Nothing is hidden by anything, and no motion blurs
# anything.

Array = NDArray[np.float64]

NARROWEST_PX = 3.0  # of a tag's modules: nine of ten in rendered frames have edges from there on, else one of ten
STEEPEST = 0.35  # cosine between a tag's normal and the way to it: 70 degrees
NEAREST_M, FARTHEST_M = 0.15, 2.2  # in rendered frames of tap water some tags are read at 2.3 m
POINTS_M2 = 600.0  # points worth following, on floor and walls
FOLLOWED_PX = 0.17  # half of them are within 0.2 px of where they should be
TURNS = ((-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0))  # corners of a tag, right and up, clockwise as seen


class DrawnCamera:
    """One robot's; `expose` in the order of time."""

    def __init__(self, fleet: Fleet, name: str, camera: CameraFit) -> None:
        seed = fleet.twin.seed
        hung = true_tags(fleet.landmarks, seed)
        self._ids = [tag.id for tag in hung]
        arms = np.array([[(right, up, 0.0) for right, up in TURNS]])
        sizes = np.array([tag.size_m for tag in hung])[:, None, None]
        axes, self._middles = np.array([tag.rotation for tag in hung]), np.array([tag.position_m for tag in hung])
        self._corners = self._middles[:, None] + 0.5 * sizes * np.einsum("nij,mkj->nki", axes, arms)
        self._out = axes[:, :, 2]
        self._points = points_of_planes(generator(seed, "points"))
        self._camera, self._camera_m = camera, fleet.body.camera_m
        self._rng = generator(seed, name, "drawn camera")
        self._frames = 0
        self._key: tuple[int, Array, Array] | None = None  # exposure, numbers of points, slopes then
        self._before: tuple[Array, NDArray[np.bool_]] | None = None  # slopes of all points, and which were seen
        self._moved_ns = 0  # when the picture last moved

    def expose(self, pose: RobotPose, t_ns: int) -> tuple[SeenTags, Flow | None]:
        """A frame from there, the lens at rest."""
        self._frames += 1
        eye, _ = look(pose, self._camera_m)
        at, axes = np.asarray(eye.position_m), np.asarray(eye.rotation)
        return SeenTags(t_ns=t_ns, frame=self._frames, tags=self._tags(at, axes)), self._flow(at, axes, t_ns)

    def interrupt(self) -> None:
        """The lens moves: what was followed is lost."""
        self._key = self._before = None

    def _tags(self, at: Array, axes: Array) -> tuple[SeenTag, ...]:
        slopes, depths = self._project(self._corners.reshape(-1, 3), at, axes)
        slopes, depths = slopes.reshape(-1, 4, 2), depths.reshape(-1, 4)
        f_px = self._camera.f_px
        way = at - self._middles
        facing = np.sum(way * self._out, axis=1) / np.linalg.norm(way, axis=1)
        size_px = f_px * np.linalg.norm(np.roll(slopes, -1, axis=1) - slopes, axis=2).min(axis=1)
        seen = self._inside(slopes, depths).all(axis=1) & (facing > STEEPEST)
        found = []
        for k in np.flatnonzero(seen):
            if module_px(f_px * slopes[k]) < NARROWEST_PX:
                continue
            corners, rho_px = slopes[k], f_px * float(np.hypot(*slopes[k].mean(axis=0)))
            offset_px = OFFSET_PX + BENT_PX * (rho_px / (EDGE_AT * self._camera.width_px)) ** 3
            off_px = self._rng.normal(0.0, EDGE_PX, (4, 2)) + self._rng.normal(0.0, offset_px, 2)
            larger = self._rng.normal(0.0, STRETCH) * (corners - corners.mean(axis=0))
            told = (corners + larger + off_px / f_px).tolist()
            a, b, c, d = ((x, y) for x, y in told)
            found.append(SeenTag(self._ids[k], (a, b, c, d), float(size_px[k]), rho_px, True))
        return tuple(found)

    def _flow(self, at: Array, axes: Array, t_ns: int) -> Flow | None:
        """Points of the key frame that are still in the picture; a new one where that is due."""
        slopes, depths = self._project(self._points, at, axes)
        here = self._inside(slopes, depths)
        told = None
        self._heed(slopes, here, t_ns)
        if self._key is not None:
            since_ns, numbers, then = self._key
            left = here[numbers]
            kept = np.flatnonzero(left)[:MOST]
            now = slopes[numbers[kept]] + self._rng.normal(0.0, FOLLOWED_PX / self._camera.f_px, (len(kept), 2))
            pairs = np.hstack([then[kept], now]).tolist()
            told = Flow(t_ns=t_ns, since_ns=since_ns, pairs=tuple((a, b, c, d) for a, b, c, d in pairs))
            if has_settled(since_ns, t_ns, self._moved_ns) or is_due(since_ns, t_ns, left):
                self._key = None
        if self._key is None:
            numbers = self._rng.permutation(np.flatnonzero(here))
            self._key = t_ns, numbers, slopes[numbers]
        return told if told is not None and told.pairs else None

    def _heed(self, slopes: Array, here: NDArray[np.bool_], t_ns: int) -> None:
        """Take note of whether the picture moved since the frame before."""
        if self._before is not None:
            both = here & self._before[1]
            steps_px = self._camera.f_px * np.linalg.norm(slopes[both] - self._before[0][both], axis=1)
            if not len(steps_px) or np.median(steps_px) > STILL_PX:
                self._moved_ns = t_ns
        self._before = slopes, here

    def _project(self, points_m: Array, at: Array, axes: Array) -> tuple[Array, Array]:
        """Slopes (n, 2) and depths (n,) of points (n, 3)."""
        x, y, z = ((points_m - at) @ axes).T
        depths = z - self._camera.ahead_m
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.stack([x, y], axis=1) / depths[:, None], depths

    def _inside(self, slopes: Array, depths: Array) -> NDArray[np.bool_]:
        half = np.array([self._camera.width_px, self._camera.height_px]) / (2.0 * self._camera.f_px)
        near = (depths > NEAREST_M) & (depths < FARTHEST_M)
        return np.asarray(near & (np.abs(slopes) < half).all(axis=-1))


def points_of_planes(rng: np.random.Generator) -> Array:
    """Points (n, 3) all over the floor and the walls, as far as they are wet."""
    length_m, breadth_m, _ = TANK.size_m
    sides = (length_m, breadth_m, TANK.surface_m)
    found = []
    for axis, level_m in ((2, 0.0), (0, 0.0), (0, length_m), (1, 0.0), (1, breadth_m)):
        area_m2 = np.prod([side for k, side in enumerate(sides) if k != axis])
        points = rng.uniform(0.0, sides, (round(POINTS_M2 * float(area_m2)), 3))
        points[:, axis] = level_m
        found.append(points)
    return np.concatenate(found)


# --- drawn ball: its outline, and clarity at each lens position of a sweep ---
# What it errs by is what the kernel is told that it errs by: the picture by its noise, and in its radius alike from
# frame to frame; the lens by its calibration's covariance and noise, drawn once, and for each sweep; so that a
# measurement is as good as it says.

# What the bench finds of a robot of the twin, rounded.
FOCUS = FocusFit(
    u_inf_m=0.0012,
    b_m=136.5,
    rho0=91.7,
    covariance=(6.0357e-07, -4.6495e-04, 5.7052e-04, 0.36813, -0.46705, 0.62577),
    noise=0.4,
    width=119.0,
    lowest=208,
    highest=717,
    r2=0.999,
    rmse_m=0.008,
    held_out_rmse_m=0.008,
)
RADIUS_SIGMA_PX = 0.2
BALL_FARTHEST_M = 1.6
OUTLINE = 24  # points of it that are looked at
SHOWN = 0.5  # of them in the picture, or it is not found: a ball that its edge halves is found to 0.2 px
CIRCLE = tuple((math.cos(2.0 * math.pi * k / OUTLINE), math.sin(2.0 * math.pi * k / OUTLINE)) for k in range(OUTLINE))


BallPath = Callable[[int], Vector]  # where it is at a time, ns


class Pillar(NamedTuple):
    """Upright, from the floor to the surface."""

    x_m: float
    y_m: float
    radius_m: float


def ring(robot: RobotPose) -> Pillar:
    """A robot as what hides things."""
    x, y, _ = robot.position_m.tolist()
    return Pillar(x, y, RING_M)


class DrawnTarget:
    """One robot's view of one target; path: where that lies, or its path."""

    def __init__(self, fleet: Fleet, path: Vector | BallPath) -> None:
        self._target, self._path, self._frames = next(iter(fleet.target)), path, 0

    def sight(
        self, pose: RobotPose, t_ns: int, plan: SweepPlan | None = None, index: int = -1, before: Sequence[Pillar] = ()
    ) -> Sighting:
        """The newest frame; plan, index: at which position of which sweep. before: what may be before the target, and
        hides it where its middle is behind."""
        self._frames += 1
        sweep = 0 if plan is None else plan.sweep
        self._begins(sweep)
        at_m = self._path(t_ns) if callable(self._path) else self._path
        x, y, _ = pose.position_m.tolist()
        hidden = any(hides(pillar, (x, y), at_m) for pillar in before)
        lens_position = None if plan is None else plan.focus[index]
        shows = None if hidden else self._shows(pose, t_ns, at_m, lens_position)
        frame = Sighting(
            t_ns=t_ns,
            frame=self._frames,
            sweep=sweep,
            index=index,
            focus=lens_position,
            target=self._target,
            found=shows is not None,
        )
        return frame if shows is None else msgspec.structs.replace(frame, **shows)

    def unseen(self, t_ns: int) -> Sighting:
        """The newest frame, of a camera that is covered."""
        self._frames += 1
        return Sighting(t_ns=t_ns, frame=self._frames, target=self._target, found=False)

    def _begins(self, sweep: int) -> None:
        """Asked of each frame, whether it shows anything or not; 0: no sweep."""

    def _shows(self, pose: RobotPose, t_ns: int, at_m: Vector, lens_position: int | None) -> dict[str, Any] | None:
        """What a Sighting says of a target that is there with nothing before it; None: it is not found."""
        raise NotImplementedError


def frame_error_m(fleet: Fleet) -> Vector:
    """By how much the frame that all robots share is off the tank's, drawn as the fleet's budget has it. Swimmers know
    the tank's own: their errors as they state them are judged with this one added."""
    budget, rng = fleet.budget, generator(fleet.twin.seed, "frame")
    x, y, z = rng.normal(0.0, (budget.survey_m, budget.survey_m, budget.level_m)).tolist()
    return x, y, z


class DrawnBall(DrawnTarget):
    """A ball; ball_m: where it lies, or its path."""

    def __init__(self, fleet: Fleet, name: str, camera: CameraFit, ball_m: Vector | BallPath) -> None:
        super().__init__(fleet, ball_m)
        target = fleet.target[self._target]
        assert target.radius_m is not None  # a ball
        self._rng = generator(fleet.twin.seed, name, "drawn ball")
        self._radius_m = target.radius_m + float(
            generator(fleet.twin.seed, "radius").normal(
                0.0, math.hypot(target.radius_sigma_m, fleet.budget.scale * target.radius_m)
            )
        )
        self._camera, self._camera_m = camera, fleet.body.camera_m
        off = self._rng.multivariate_normal(np.zeros(3), full(FOCUS.covariance))
        self._lens = np.array([FOCUS.u_inf_m, FOCUS.b_m, FOCUS.rho0]) + off
        self._shift, self._sweep = 0.0, 0
        self._wide_px = float(self._rng.normal(0.0, RADIUS_SIGMA_PX))

    def _begins(self, sweep: int) -> None:
        if sweep != self._sweep:
            self._sweep, self._shift = sweep, float(self._rng.normal(0.0, FOCUS.noise))

    def _shows(self, pose: RobotPose, t_ns: int, at_m: Vector, lens_position: int | None) -> dict[str, Any] | None:
        seen = self._outline(pose, at_m)
        if seen is None:
            return None
        centre_px, radius_px, peak = seen
        return {
            "centre_px": centre_px,
            "radius_px": radius_px,
            "clarity": None if lens_position is None else _clarity(lens_position - peak - self._shift),
            "area_px": math.pi * (0.5 * radius_px) ** 2,
            "score": 1.0,
            "radius_sigma_px": RADIUS_SIGMA_PX,
        }

    def _outline(self, pose: RobotPose, ball_m: Vector) -> tuple[tuple[float, float], float, float] | None:
        """Centre and radius in the picture, px, and the lens position at which it is sharpest; None: not in sight."""
        eye, _ = look(pose, self._camera_m)
        way: NDArray[np.float64] = (np.array(ball_m) - np.asarray(eye.position_m)) @ np.asarray(eye.rotation)
        x, y, z = way.tolist()
        centre = pixel(self._camera, (x, y, z))
        distance_m = math.hypot(x, y, z - self._camera.ahead_m)
        if centre is None or not self._radius_m < distance_m < BALL_FARTHEST_M:
            return None
        noise_px = math.hypot(self._camera.noise_px, CENTRE_NOISE_PX)
        u, v = (float(value) for value in np.array(centre) + self._rng.normal(0.0, noise_px, 2))
        radius_px = self._camera.f_px * math.tan(math.asin(self._radius_m / distance_m))
        width, height = self._camera.width_px, self._camera.height_px
        shown = sum(0.0 < u + radius_px * x < width and 0.0 < v + radius_px * y < height for x, y in CIRCLE)
        if shown < SHOWN * OUTLINE:
            return None
        skin_m = distance_m - self._radius_m
        for _ in range(5):
            skin_m = distance_m - centre_behind_skin_m(skin_m, self._radius_m)
        u_inf, b, rho0 = self._lens
        peak = rho0 + b / (as_on_axis(skin_m * z / distance_m, port_share(self._camera, centre)) - u_inf)
        return (u, v), radius_px + self._wide_px + float(self._rng.normal(0.0, EDGE_NOISE_PX)), float(peak)


def hides(pillar: Pillar, from_m: tuple[float, float], ball_m: Vector) -> bool:
    """As seen from above: all hover at one depth, the ball a little below."""
    way = ball_m[0] - from_m[0], ball_m[1] - from_m[1]
    to = pillar.x_m - from_m[0], pillar.y_m - from_m[1]
    along = (to[0] * way[0] + to[1] * way[1]) / (way[0] * way[0] + way[1] * way[1])
    return 0.0 < along < 1.0 and math.hypot(to[0] - along * way[0], to[1] - along * way[1]) < pillar.radius_m


def _clarity(from_peak: float) -> float:
    """The curve of a lens so many positions away from its peak."""
    return 100.0 + 900.0 / (1.0 + (from_peak / FOCUS.width) ** 2)


# --- swimmers ---

FRAME_STEPS, LATE_STEPS = 2, 2
TOLD = (NEAR, CLAIM, KEYFRAME, LIGHT)  # what neighbours are told beside estimates


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
        """Each message of an agent, of any kind, arrives with the next step, as from its own key."""
        for estimate in outputs.says:
            self._post_to(estimate.dst, src, estimate)
        for row in TOLD:
            for letter in outputs.said(row):
                self._post_to(letter.dst, src, letter, row.name)

    def _post_to(self, dst: str, src: str, letter: Message, topic: str | UnsetType = UNSET) -> None:
        if not self.lost(letter):
            payload = encode(self.forged(letter))
            self._post[dst].append(Heard(arrived_ns=self.now_ns, src=src, payload=payload, topic=topic))

    def swimmer(self, name: str) -> Swimmer:
        found = swimmer_of(self.agents[name].capabilities)
        assert found is not None
        return found

    def swims(self, name: str) -> bool:
        """Whether it is armed, and does what it is told."""
        return self.swimmer(name).under_way

    def place(self, name: str) -> tuple[float, float, float]:
        """Where it truly is: x and y (m), yaw (rad)."""
        pose = self.bodies.pose(name)
        x, y, _ = pose.position_m.tolist()
        return x, y, float(np.arctan2(pose.rotation[1, 0], pose.rotation[0, 0]))

    def least_apart_m(self) -> float:
        """Between the true centres of any two."""
        places = [self.place(name)[:2] for name in self.agents]
        return min((math.dist(a, b) for a, b in itertools.combinations(places, 2)), default=math.inf)

    def each_step(self, seconds: float) -> Iterator[float]:
        """Step on for so long; after each step the seconds since now."""
        before_ns = self.now_ns
        for _ in range(round(seconds * 1e9 / STEP_NS)):
            self.step()
            yield (self.now_ns - before_ns) * 1e-9

    def path(self, name: str, seconds: float) -> Array:
        """Step on for so long: t (s, from now), x, y (m) and yaw (rad) after each step, (n, 4)."""
        return np.array([(t, *self.place(name)) for t in self.each_step(seconds)])

    def until_swims(self, name: str, at_most_s: float) -> bool:
        """Step on until it is armed, and has found itself."""
        return any(self.swims(name) for _ in self.each_step(at_most_s))
