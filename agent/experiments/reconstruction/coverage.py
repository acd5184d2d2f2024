"""How many keyframes it takes until a tank is known, by robots that share what they saw, and by robots that do not.

The kernel's agents in virtual time, moored around drawn things. A sweep takes three seconds; what its blocks measure is
the truth of the drawn scene, with the noise that the blocks of 1280x960 pixels owe to their grid. What is said comes a
step later, or is lost. Of each run it is counted how many keyframes all robots together had made when nine tenths of
the cells that can be seen at all were known to 4 mm, by all keyframes together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from msgspec import UNSET

from agent.capabilities.survey.coverage_map import FARTHEST_M, NEAREST_M, STEEPEST, CoverageMap, grid_of
from agent.capabilities.survey.survey import block_px
from agent.core.capability_messages import Claim, Keyframe
from agent.core.codec import encode
from agent.core.config import Coverage, Fleet, Pose, Robot, Survey, Tank, Target
from agent.core.ranging.camera_model import Calibration, CameraFit, camera_pose, gimbal_deg
from agent.core.ranging.focus import lens_position, phase_sigma
from agent.core.step_io import BlockPeaks, Heard, Inputs, Outputs, SweepPlan, Telemetry
from agent.experiments.navigation.drawn_ball import FOCUS
from agent.experiments.reconstruction.drawn_scene import Scene, draw_scene, look
from agent.robot.step import Agent

SURVEY_START_NS, STEP_NS, SWEEP_NS = 1_700_000_000_000_000_000, 50_000_000, 3_000_000_000
SIZE_M, SURFACE_M = (1.5, 1.2, 0.8), 0.5
PLACES = ((0.25, 0.25, 45.0), (1.25, 0.25, 135.0), (1.25, 0.95, 225.0), (0.25, 0.95, 315.0), (0.75, 0.20, 90.0))
DEPTHS_M = (0.30, 0.22, 0.32, 0.24, 0.28)
SURVEY_CAMERA = CameraFit(width_px=1280, height_px=960, f_px=1714.0, cx_px=639.5, cy_px=479.5, bend=0.39, ahead_m=0.001)
SIDE_PX = block_px(SURVEY_CAMERA)
SIGMA = math.hypot(FOCUS.noise, phase_sigma(FOCUS.width, SIDE_PX * SIDE_PX))  # of a block's peak, lens positions
SHOWS = 0.75  # of the blocks have texture enough for a peak
KNOWN, MOST = 0.9, 250  # share of the cells that ends a run, and keyframes that end one without it
MOST_S = 900.0
VIEWS, OFTEN = 600, 4  # random views of all stations; a cell that so many show in part can be seen
KINDS = {"shared": (True, 0.0), "alone": (False, 0.0), "loss30": (True, 0.3)}  # whether they share; what is lost
RUNS, BAR = len(KINDS), 0.8  # of each seed; keyframes of who shares, of those of who does not
SETTLE_S = 20.0  # in which lost keyframes are sent again, before maps are compared


class Run(NamedTuple):
    keyframes: int | None  # of all robots, when nine tenths were known; None: never
    equal: bool  # all maps alike, byte for byte, once nothing more was said
    shares: tuple[float, ...]  # of the visible cells, after each keyframe


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
        self.all = CoverageMap(grid_of(fleet))  # of everybody's keyframes
        self.record: Callable[[str, int, bytes, bytes], None] = lambda *step: None  # for a black box
        self._post: dict[str, list[Heard]] = {name: [] for name in fleet.robot}
        self._sweeps: dict[str, tuple[SweepPlan, int, Outputs]] = {}

    def step(self) -> list[int]:
        """One step of all; numbers of keyframes that were made in it."""
        self.now_ns += STEP_NS
        made = []
        for name, agent in self.agents.items():
            heard, self._post[name] = tuple(self._post[name]), []
            before = agent.survey.surveyor.keyframes if agent.survey.surveyor else 0
            peaks = self._ended(name)
            blocks = UNSET if peaks is None else (peaks,)
            inputs = Inputs(telemetry=(self._telemetry(name),), heard=heard, blocks=blocks)
            outputs = agent.step(inputs, self.now_ns)
            self.record(name, self.now_ns, encode(inputs), encode(outputs))
            surveyor = agent.survey.surveyor
            if surveyor is not None and surveyor.keyframes > before:
                self.all.add(surveyor.known.held[name, SURVEY_START_NS, surveyor.keyframes].frame)
                made.append(surveyor.keyframes)
            if outputs.sweep is not None and outputs.sweep.block_px:
                self._sweeps[name] = outputs.sweep, self.now_ns + SWEEP_NS, outputs
            self._carry(name, outputs)
        return made

    def equal(self) -> bool:
        maps = {agent.survey.surveyor.known.as_bytes() for agent in self.agents.values() if agent.survey.surveyor}
        keys = {tuple(sorted(a.survey.surveyor.known.held)) for a in self.agents.values() if a.survey.surveyor}
        return len(maps) == len(keys) == 1

    def stop(self) -> None:
        """No more views are chosen; what was seen is still told."""
        for agent in self.agents.values():
            if agent.survey.surveyor is not None:
                agent.survey.surveyor.phase = "done"

    def _carry(self, name: str, outputs: Outputs) -> None:
        if not self.shares:
            return
        words: tuple[Claim | Keyframe, ...] = (*(outputs.claims or ()), *(outputs.keyframes or ()))
        for word in words:
            if self.rng.random() >= self.loss:
                topic: Literal["claim", "keyframe"] = "claim" if isinstance(word, Claim) else "keyframe"
                heard = Heard(arrived_ns=self.now_ns, src=name, payload=encode(word), topic=topic)
                self._post[word.dst].append(heard)

    def _telemetry(self, name: str) -> Telemetry:
        depth_m = self.fleet.robot[name].depth_m
        return Telemetry(
            t_ns=self.now_ns,
            board_us=0,
            depth_m=depth_m,
            roll_deg=0.0,
            pitch_deg=0.0,
            sensor_depth_m=(depth_m,) * 4,
            pulses_us=(1500,) * 8,
            servos_us=(1500,) * 4,
            battery_v=14.0,
            armed=True,
            ladder=0,
            flags=0,
            loop_us=0,
        )

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


def run(seed: int, shares: bool, loss: float, compare: bool = True) -> Run:
    """Until nine tenths of the visible cells are known; compare: and on until all that was said is heard."""
    fleet = fleet_of()
    scene = draw_scene((SIZE_M[0], SIZE_M[1], SURFACE_M), seed)
    cells = visible(fleet, scene, seed)
    world, goal, shown, total = World(fleet, scene, seed, shares, loss), grid_of(fleet).goal, list[float](), 0
    for _ in range(round(MOST_S * 1e9 / STEP_NS)):
        for _ in world.step():
            total += 1
            shown.append(sum(world.all.cells.get(number, 0) >= goal for number in cells) / len(cells))
        if total and (shown[-1] >= KNOWN or total >= MOST):
            break
    reached = total if shown and shown[-1] >= KNOWN else None
    equal = False
    if compare and shares:
        world.stop()
        for _ in range(round(SETTLE_S * 1e9 / STEP_NS)):
            world.step()
        equal = world.equal()
    return Run(reached, equal, tuple(shown))


def coverage(seeds: Sequence[int], step: Callable[[], None] = lambda: None) -> dict[str, Any]:
    """{"coverage": {"shared", "alone", "loss30"}}: keyframes to nine tenths, mean over the seeds; a run that did
    not get there counts MOST. Beside it whether all maps were equal, and each run's number. step: after each run."""
    runs: dict[str, list[Run]] = {kind: [] for kind in KINDS}
    for kind, (shares, loss) in KINDS.items():
        for seed in seeds:
            runs[kind].append(run(seed, shares, loss))
            step()
    counts = {kind: [MOST if r.keyframes is None else r.keyframes for r in each] for kind, each in runs.items()}
    means = {kind: round(math.fsum(each) / max(len(each), 1), 1) for kind, each in counts.items()}
    return {
        "coverage": means,
        "coverage_runs": counts,
        "coverage_equal": {kind: all(r.equal for r in each) for kind, each in runs.items() if kind != "alone"},
    }


def missed_coverage(told: dict[str, Any]) -> list[str]:
    """What is missed of that sharing saves a fifth of the keyframes, with 30 % of all words lost too, and that maps are
    equal in the end."""
    found = []
    for kind, equal in told["coverage_equal"].items():
        ratio = told["coverage"][kind] / told["coverage"]["alone"]
        if ratio > BAR:
            found.append(f"{kind}: {ratio:.2f} times the keyframes of robots alone")
        if not equal:
            found.append(f"{kind}: maps differ")
    return found
