"""How many keyframes it takes until a tank is known, by robots that share what they saw, and by robots that do not.

A sweep takes three seconds; what its blocks measure is the truth of the drawn scene, with the noise that the blocks of
1280x960 pixels owe to their grid. What is said comes a step later, or is lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from agent.capabilities.survey.coverage_map import FARTHEST_M, NEAREST_M, STEEPEST, CoverageMap, grid_of
from agent.capabilities.survey.survey import Surveyor, block_px, surveyor_of
from agent.core.codec import encode
from agent.core.config import Coverage, Fleet, Pose, Robot, Survey, Tank, Target
from agent.core.ranging.camera_model import Calibration, CameraFit, camera_pose, gimbal_deg
from agent.core.ranging.focus import as_on_axis, lens_position, phase_sigma, share_at
from agent.core.step_io import BlockPeaks, Heard, Inputs, Outputs, SweepPlan
from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value
from agent.experiments.navigation.basin import at_rest
from agent.experiments.navigation.swimmers import FOCUS
from agent.robot.step import Agent

# --- a drawn scene ---
# A drawn scene, and what the blocks of a sweep truly see of it: a tank with things in it, and no frame is rendered.
#
# Things are ellipsoids and boxes, turned any way, and a wall that stands aslant: what lies along the axes flatters a
# grid of cells. It shares no code with the map that is judged by it.

Floats = NDArray[np.float64]
FAR_M = 1e9
SLOPE_ROUNDS = 10  # passes that take the bend out of a slope


class Body(NamedTuple):
    """One thing: a unit ball or a unit cube, stretched, turned and moved."""

    round: bool
    centre_m: Floats  # (3,)
    half_m: Floats  # (3,)
    turn: Floats  # (3, 3), world to body


class Scene(NamedTuple):
    size_m: Floats  # (3,) of the water
    bodies: tuple[Body, ...]


class Seen(NamedTuple):
    """What each block of a picture truly sees."""

    z_m: Floats  # (n,) depth along the optical axis from the pivot; inf: the surface
    points_m: Floats  # (n, 3)
    cos: Floats  # (n,) of the incidence


def draw_scene(size_m: tuple[float, float, float], seed: int, things: int = 5) -> Scene:
    """Things on the floor, in the middle half of the tank, and a plate that leans aslant."""
    rng, bodies = np.random.default_rng((seed, 77)), []
    length, breadth, _ = size_m
    for k in range(things):
        half = rng.uniform(0.03, 0.08, 3)
        centre = np.array([length * rng.uniform(0.3, 0.7), breadth * rng.uniform(0.3, 0.7), half[2] * 0.8])
        bodies.append(Body(k % 2 == 0, centre, half, _turned(rng.normal(size=3), rng.uniform(0.0, np.pi))))
    yaw = rng.uniform(0.0, np.pi)
    plate = np.array([0.18, 0.012, 0.10])
    centre = np.array([length * rng.uniform(0.4, 0.6), breadth * rng.uniform(0.4, 0.6), 0.09])
    lean = _turned(np.array([np.cos(yaw), np.sin(yaw), 0.0]), rng.uniform(-0.3, 0.3))
    bodies.append(Body(False, centre, plate, _turned(np.array([0.0, 0.0, 1.0]), -yaw) @ lean.T))
    return Scene(np.array(size_m), tuple(bodies))


def slopes(camera: CameraFit, side_px: int) -> Floats:
    """(n, 2) of the middles of all blocks, row by row."""
    cols, rows = camera.width_px // side_px, camera.height_px // side_px
    u, v = np.meshgrid((np.arange(cols) + 0.5) * side_px - 0.5, (np.arange(rows) + 0.5) * side_px - 0.5)
    seen = np.stack([(u.ravel() - camera.cx_px), (v.ravel() - camera.cy_px)], axis=1) / camera.f_px
    straight = seen.copy()
    for _ in range(SLOPE_ROUNDS):
        straight = seen / (1.0 + camera.bend * (straight**2).sum(axis=1, keepdims=True))
    return straight


def block_shares(camera: CameraFit, side_px: int) -> list[float]:
    """What the flat port of the camera makes of the depths of its blocks: `ranging.focus.share_at`."""
    return [share_at(camera, 1.0 / math.sqrt(1.0 + x * x + y * y)) for x, y in slopes(camera, side_px).tolist()]


def look(scene: Scene, at_m: Floats, rotation: Floats, camera: CameraFit, side_px: int) -> Seen:
    """at_m, rotation: the pivot in the world, and the turn from camera to world."""
    s = slopes(camera, side_px)
    ways = np.column_stack([s, np.ones(len(s))]) @ rotation.T
    start = at_m + rotation @ np.array([0.0, 0.0, camera.ahead_m])
    with np.errstate(divide="ignore", invalid="ignore"):
        out = np.where(ways > 0.0, (scene.size_m - start) / ways, np.where(ways < 0.0, -start / ways, FAR_M))
    face = out.argmin(axis=1)
    t, rows = out[np.arange(len(out)), face], np.arange(len(out))
    normals = np.zeros_like(ways)
    normals[rows, face] = -np.sign(ways[rows, face])
    open_above = (face == 2) & (ways[:, 2] > 0.0)
    for body in scene.bodies:
        hit, normal = _meet(body, start, ways)
        nearer = hit < t
        t, open_above = np.where(nearer, hit, t), open_above & ~nearer
        normals[nearer] = normal[nearer]
    cos = np.abs((ways * normals).sum(axis=1)) / np.linalg.norm(ways, axis=1)
    points = start + t[:, None] * ways
    z = np.where(open_above, np.inf, t + camera.ahead_m)
    return Seen(z, points, cos)


def _meet(body: Body, start: Floats, ways: Floats) -> tuple[Floats, Floats]:
    """How far along each ray it is met, and the surface's normal there."""
    p, d = (body.turn @ (start - body.centre_m)) / body.half_m, (ways @ body.turn.T) / body.half_m
    if body.round:
        dd, dp = (d * d).sum(axis=1), d @ p
        root = dp * dp - dd * (p @ p - 1.0)
        t = np.where(root > 0.0, (-dp - np.sqrt(np.maximum(root, 0.0))) / dd, FAR_M)
        own = (p + t[:, None] * d) / body.half_m
    else:
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = (-1.0 - p) / d, (1.0 - p) / d
        near, far = np.minimum(a, b), np.maximum(a, b)
        axis = near.argmax(axis=1)
        t = near.max(axis=1)
        t = np.where(t < far.min(axis=1), t, FAR_M)
        own = np.eye(3)[axis]
    normal = own @ body.turn
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.where(t > 0.0, t, FAR_M), normal


def _turned(axis: Floats, angle: float) -> Floats:
    """Rodrigues."""
    x, y, z = axis / np.linalg.norm(axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k))


def found_in(
    plan: SweepPlan, camera: CameraFit, side: int, peaks: Sequence[tuple[int, float, float]], t_ns: int
) -> BlockPeaks:
    """What a robot is told of a sweep over whole frames, in blocks of `side` px, by peaks that were drawn."""
    return BlockPeaks(
        t_ns=t_ns,
        sweep=plan.sweep,
        focus=plan.focus[-1],
        block_px=side,
        cols=camera.width_px // side,
        rows=camera.height_px // side,
        peaks=tuple(peaks),
    )


# --- the claim ---

# --- moored robots around one scene ---

SURVEY_START_NS, STEP_NS, SWEEP_NS = 1_700_000_000_000_000_000, 50_000_000, 3_000_000_000
SIZE_M, SURFACE_M = (1.5, 1.2, 0.8), 0.5
PLACES = ((0.25, 0.25, 45.0), (1.25, 0.25, 135.0), (1.25, 0.95, 225.0), (0.25, 0.95, 315.0), (0.75, 0.20, 90.0))
DEPTHS_M = (0.30, 0.22, 0.32, 0.24, 0.28)
SURVEY_CAMERA = CameraFit(width_px=1280, height_px=960, f_px=1714.0, cx_px=639.5, cy_px=479.5, bend=0.39, ahead_m=0.001)
SIDE_PX = block_px(SURVEY_CAMERA)
SIGMA = math.hypot(FOCUS.noise, phase_sigma(FOCUS.width, SIDE_PX * SIDE_PX))  # of a block's peak, lens positions
SHOWS = 0.75  # of the blocks have texture enough for a peak
VIEWS, OFTEN = 600, 4  # random views of all stations; a cell that so many show in part can be seen


def fleet_of(goal_mm: float = 4.0, count: int = len(PLACES)) -> Fleet:
    """Moored robots, five at most, each linked to all."""
    names = [f"r{k + 1}" for k in range(count)]
    robots = {
        name: Robot(
            neighbours=tuple(other for other in names if other != name),
            listen=f"tcp/127.0.0.1:{17401 + k}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=x, y_m=y, yaw_deg=yaw),
            depth_m=DEPTHS_M[k],
            calibration=f"{name}.toml",
            behaviour=Survey(),
        )
        for k, (name, (x, y, yaw)) in enumerate(zip(names, PLACES, strict=False))
    }
    return Fleet(
        fleet="survey",
        tank=Tank(size_m=SIZE_M, surface_m=SURFACE_M),
        target={"ball": Target(radius_m=0.07)},
        robot=robots,
        coverage=Coverage(goal_mm=goal_mm, share=1.0),
    )


class World:
    """Agents around one drawn scene."""

    def __init__(self, fleet: Fleet, scene: Scene, seed: int, shares: bool, loss: float) -> None:
        self.fleet, self.scene, self.shares, self.loss = fleet, scene, shares, loss
        self.rng = np.random.default_rng((seed, 5))
        self.calibration = Calibration(robot="r1", made="", source="", focus=FOCUS, camera=SURVEY_CAMERA)
        self.agents = {name: Agent(fleet, name, self.calibration, SURVEY_START_NS) for name in fleet.robot}
        self.now_ns = SURVEY_START_NS
        self.all = CoverageMap(grid_of(fleet))  # of all robots' keyframes
        self.record: Callable[[str, int, bytes, bytes], None] = lambda *step: None  # for a black box
        self._post: dict[str, list[Heard]] = {name: [] for name in fleet.robot}
        self._sweeps: dict[str, tuple[SweepPlan, int, Outputs]] = {}

    def step(self) -> list[int]:
        """One step of all; numbers of keyframes that were made in it."""
        self.now_ns += STEP_NS
        made = []
        for name, agent in self.agents.items():
            heard, self._post[name] = tuple(self._post[name]), []
            surveyor = surveyor_of(agent.capabilities)
            before = surveyor.keyframes if surveyor else 0
            peaks = self._ended(name)
            blocks = UNSET if peaks is None else (peaks,)
            telemetry = at_rest(self.now_ns, True, self.fleet.robot[name].depth_m)
            inputs = Inputs(telemetry=(telemetry,), heard=heard, blocks=blocks)
            outputs = agent.step(inputs, self.now_ns)
            self.record(name, self.now_ns, encode(inputs), encode(outputs))
            if surveyor is not None and surveyor.keyframes > before:
                self.all.add(surveyor.known.held[name, SURVEY_START_NS][surveyor.keyframes].frame)
                made.append(surveyor.keyframes)
            if outputs.sweep is not None and outputs.sweep.block_px:
                self._sweeps[name] = outputs.sweep, self.now_ns + SWEEP_NS, outputs
            self._carry(name, outputs)
        return made

    def equal(self) -> bool:
        maps = {surveyor.known.as_bytes() for surveyor in self._surveyors()}
        keys = {tuple(surveyor.known.all_keys()) for surveyor in self._surveyors()}
        return len(maps) == len(keys) == 1

    def stop(self) -> None:
        """No more views are chosen; what was seen is still told."""
        for surveyor in self._surveyors():
            surveyor.phase = "done"

    def _surveyors(self) -> list[Surveyor]:
        own = (surveyor_of(agent.capabilities) for agent in self.agents.values())
        return [each for each in own if each is not None]

    def _carry(self, name: str, outputs: Outputs) -> None:
        if not self.shares:
            return
        for said in outputs.outgoing or ():
            if self.rng.random() >= self.loss:
                heard = Heard(arrived_ns=self.now_ns, src=name, payload=said.payload, topic=said.topic)
                self._post[said.to].append(heard)

    def _ended(self, name: str) -> BlockPeaks | None:
        """What a sweep measured that is over now."""
        if name not in self._sweeps or self.now_ns < self._sweeps[name][1]:
            return None
        plan, _, outputs = self._sweeps.pop(name)
        side = plan.block_px
        eye = gimbal_eye(self.fleet, name, outputs.set_point.servos_us[:2])
        seen = look(self.scene, np.array(eye.position_m), np.array(eye.rotation), SURVEY_CAMERA, side)
        peaks, shares = [], block_shares(SURVEY_CAMERA, side)
        for k, z_m in enumerate(seen.z_m):
            if not (0.08 < z_m < 1.6) or self.rng.random() > SHOWS or seen.cos[k] < STEEPEST:
                continue
            peaks.append(
                (k, lens_position(FOCUS, as_on_axis(float(z_m), shares[k])) + float(self.rng.normal(0.0, SIGMA)), SIGMA)
            )
        return found_in(plan, SURVEY_CAMERA, side, peaks, self.now_ns - STEP_NS)


def sigma_m(z_m: float) -> float:
    """Of a block's depth there."""
    return SIGMA * (z_m - FOCUS.u_inf_m) ** 2 / FOCUS.b_m


def gimbal_eye(fleet: Fleet, name: str, servos: Sequence[float]) -> Any:
    """Where a robot's camera truly is: the calibration is exact here."""
    robot, surface_m = fleet.robot[name], fleet.tank.surface_m
    angles = gimbal_deg(SURVEY_CAMERA, fleet.body, (servos[0], servos[1]))
    return camera_pose(robot.pose, fleet.body, robot.depth_m, 0.0, 0.0, *angles, surface_m)


def visible(fleet: Fleet, scene: Scene, seed: int) -> frozenset[int]:
    """Cells that the stations can see at all: that OFTEN of VIEWS random views show well enough to count."""
    rng, grid = np.random.default_rng((seed, 9)), grid_of(fleet)
    names, counts = list(fleet.robot), dict[int, int]()
    for k in range(VIEWS):
        name = names[k % len(names)]
        pan, tilt = rng.uniform(-90.0, 90.0), rng.uniform(-55.0, 5.0)
        robot = fleet.robot[name]
        eye = camera_pose(robot.pose, fleet.body, robot.depth_m, 0.0, 0.0, pan, tilt, fleet.tank.surface_m)
        seen = look(scene, np.array(eye.position_m), np.array(eye.rotation), SURVEY_CAMERA, block_px(SURVEY_CAMERA))
        good = (seen.z_m > NEAREST_M) & (seen.z_m < FARTHEST_M) & (seen.cos > STEEPEST)
        for number in {grid.number(*map(float, point)) for point in seen.points_m[good]} - {None}:
            assert number is not None
            counts[number] = counts.get(number, 0) + 1
    return frozenset(number for number, count in counts.items() if count >= OFTEN)


# --- the claim ---

KINDS = {"shared": (True, 0.0), "alone": (False, 0.0), "loss30": (True, 0.3)}  # whether they share; what is lost
MOST, MOST_S = 250, 900.0  # keyframes and seconds that end a run in which not enough gets known
SETTLE_S = 20.0  # in which lost keyframes are sent again, before maps are compared


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    known: float = 0.9  # share of the visible cells that ends a run


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """keyframes: of all robots, until enough is known, None: never; equal: whether all maps are alike, byte for byte,
    once all that was said is heard."""
    shares, loss = KINDS[case]
    fleet, scene = fleet_of(), draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), seed)
    world, cells = World(fleet, scene, seed, shares, loss), visible(fleet, scene, seed)
    keyframes, known, goal = 0, 0.0, grid_of(fleet).goal
    for _ in range(round(MOST_S * 1e9 / STEP_NS)):
        if made := len(world.step()):
            keyframes += made
            known = sum(world.all.cells.get(number, 0) >= goal for number in cells) / len(cells)
        if known >= settings.known or keyframes >= MOST:
            break
    reached = keyframes if known >= settings.known else None
    if not shares:
        return [{"keyframes": reached}]
    world.stop()
    for _ in range(round(SETTLE_S * 1e9 / STEP_NS)):
        world.step()
    return [{"keyframes": reached, "equal": world.equal()}]


def summary(rows: Rows) -> dict[str, Value]:
    """Means over the seeds; a run in which not enough got known counts MOST."""
    means = {
        case: math.fsum(MOST if row["keyframes"] is None else row["keyframes"] for row in each) / len(each)
        for case, each in rows.items()
    }
    found: dict[str, Value] = {f"{case}_keyframes": mean for case, mean in means.items()}
    for case in means.keys() - {"alone"}:
        equal = [row["equal"] for row in rows[case]]
        found[f"{case}_equal"] = Share(sum(equal), len(equal))
        if "alone" in means:
            found[f"{case}_ratio"] = means[case] / means["alone"]
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(KINDS),
    quick={"known": 0.2},
    measured_on="twin",
    figures=(
        Figure("alone_keyframes", "keyframes of robots that do not share"),
        Figure("shared_keyframes", "of robots that share what they see"),
        Figure("shared_ratio", "keyframes of robots that share, of those that do not", most=0.8),
        Figure("shared_equal", "all maps are equal in the end, of the seeds", "%", least=95.0),
        Figure("loss30_keyframes", "of robots that share, 30 % of all that is said is lost"),
        Figure("loss30_ratio", "the same where 30 % of all that is said is lost", most=0.8),
        Figure("loss30_equal", "all maps are equal in the end, with that loss", "%", least=95.0),
    ),
    seeds=60,  # as many as the 95 % take
    explanation="""Five moored robots choose by themselves where to look next. Counted are the keyframes that all of
        them take until nine tenths of the cells that can be seen at all are known to 4 mm. Robots that share tell one
        another what they saw and will look at; maps are compared byte for byte once nothing more is said. Each seed
        is another scene of drawn things, and other noise of what the blocks of a sweep measure.""",
)
