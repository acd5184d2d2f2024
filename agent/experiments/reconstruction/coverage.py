"""How many keyframes it takes until a tank is known, by robots that share what they saw, and by robots that do not.

A sweep takes three seconds; what its blocks measure is the truth of the drawn scene, with the noise that the blocks of
1280x960 pixels owe to their grid. What is said comes a step later, or is lost.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
import numpy as np
from msgspec import UNSET

from agent.capabilities.survey.coverage_map import FARTHEST_M, NEAREST_M, STEEPEST, CoverageMap, grid_of
from agent.capabilities.survey.survey import Surveyor, block_px, surveyor_of
from agent.core.codec import encode
from agent.core.config import Coverage, Fleet, Pose, Robot, Survey, Tank, Target
from agent.core.ranging.camera_model import Calibration, CameraFit, camera_pose, gimbal_deg
from agent.core.ranging.focus import lens_position, phase_sigma
from agent.core.step_io import BlockPeaks, Heard, Inputs, Outputs, SweepPlan
from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value
from agent.experiments.navigation.basin import at_rest
from agent.experiments.navigation.swimmers import FOCUS
from agent.experiments.reconstruction.drawn_scene import Scene, draw_scene, found_in, look
from agent.robot.step import Agent

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
        peaks = []
        for k, z_m in enumerate(seen.z_m):
            if not (0.08 < z_m < 1.6) or self.rng.random() > SHOWS or seen.cos[k] < STEEPEST:
                continue
            peaks.append((k, lens_position(FOCUS, float(z_m)) + float(self.rng.normal(0.0, SIGMA)), SIGMA))
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
    explanation="""Five moored robots choose by themselves where to look next, and count how many keyframes all of them
        take until nine tenths of the cells that can be seen at all are known to 4 mm. Robots that share tell one
        another what they saw and will look at; maps are compared byte for byte once nothing more is said. Each seed
        is another scene of drawn things, and other noise of what the blocks of a sweep measure.""",
)
