"""Keyframes of a survey in the dark, of three robots at rest: blocks with a peak, by which lamps.

Three robots stand in a basin with drawn things on its floor. Each takes the view that would tell a robot most that
knows nothing yet (capabilities/survey/candidates.py). `ahead`: its own lamp alone, aimed a metre ahead as it goes with
the camera; `own`: the same, aimed at what the view is to show; `all`: every lamp burns and goes with its own camera;
`rule`: by capabilities/light/allocate.py, where all truly are. Frames are rendered; light adds up, so each lamp is
rendered once for each lens position, and any set of them is a sum, exposed as the camera would.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.capabilities.light.allocate import AHEAD_M, FrameScene, Lamp, aim_of, allocate_frame
from agent.capabilities.survey.candidates import Best, Candidate, Where, ahead, better, drawn, frame_scene
from agent.capabilities.survey.coverage_map import FARTHEST_M, NEAREST_M, CoverageMap, grid_of, place_m, rotation
from agent.capabilities.survey.survey import block_px, lens_of, sigma_of
from agent.core.attitude import Attitude
from agent.core.config import Lighting, Pose
from agent.core.ranging.focus import h
from agent.core.ranging.sweep import full_positions
from agent.core.step_io import SweepPlan
from agent.experiments.ball_measurements import PosedRobot
from agent.experiments.claim import Claim, Figure, Row, Rows, Value
from agent.experiments.dark_water import WATERS
from agent.perception.depth_sweep import BlockSweep
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Hull, LampBeam, Moment
from hw.twin.scene import Solid, generator, in_daylight, load_scene
from hw.twin.truth import true_tags

APART_M, FROM_WALL_M = 0.6, 0.35  # of robots
DRAWS = 12  # views that each has to choose from
THINGS = 8
NEAR_ENOUGH = 0.05  # of its depth, or three sigma: so far off a block may be, and count

Array = NDArray[np.float64]


class Posed(NamedTuple):
    """One robot, and the view that it takes."""

    name: str
    pose: Pose
    level: Attitude
    view: Candidate
    eye: Eye


class Basin:
    """One world: basin, things, lens, water."""

    def __init__(self, water: str, seed: int) -> None:
        self.lighting = Lighting(water=WATERS[water])
        fleet, scene = load_fleet(fleet_file("survey")), load_scene("survey")
        robots = {name: replace(robot, lamp=True) for name, robot in fleet.robot.items()}
        self.fleet = replace(fleet, lighting=self.lighting, robot=robots, twin=replace(fleet.twin, seed=seed))
        self._rng = np.random.default_rng((seed, 23))
        self.solids = tuple(self._things())
        daylight = in_daylight(replace(scene, solid=()))
        self.calibration = PosedRobot(self.fleet, "r1", daylight.camera).calibrate()
        self.lens, self.tags = draw_lens(scene.camera, generator(seed, "r1", "lens")), true_tags(fleet.landmarks, seed)
        optics = {key: getattr(WATERS[water], key) for key in ("absorption_per_m", "scattering_per_m")}
        dark = replace(scene, room_light=0.0, water=replace(scene.water, **optics), solid=self.solids)
        index = fleet.water.refractive_index
        self.painter = Painter(dark, fleet.tank, index, self.lens, seed, "r1", self.tags)
        self.painter.prepare()
        self._aim, self._grid = aim_of(self.fleet, self.lighting), grid_of(self.fleet)

    def _things(self) -> Iterator[Solid]:
        length, breadth, _ = self.fleet.tank.size_m
        for k in range(THINGS):
            half = self._rng.uniform((0.04, 0.03, 0.03), (0.12, 0.10, 0.07))
            x, y = self._rng.uniform((0.15, 0.15), (length - 0.15, breadth - 0.15))
            turn = tuple(float(deg) for deg in self._rng.uniform((-180.0, -15.0, -15.0), (180.0, 15.0, 15.0)))
            radii = (float(half[0]), float(half[1]), float(half[2]))
            kind = "stone" if k % 2 else "box"
            yield Solid(kind=kind, position_m=(float(x), float(y), radii[2]), radii_m=radii, turn_deg=turn)

    def robots(self, number: int) -> list[Posed]:
        """Three at drawn places, each with its view."""
        length, breadth, _ = self.fleet.tank.size_m
        places: list[Array] = []
        while len(places) < len(self.fleet.robot):
            at = self._rng.uniform((FROM_WALL_M, FROM_WALL_M), (length - FROM_WALL_M, breadth - FROM_WALL_M))
            if all(np.hypot(*(at - other)) >= APART_M for other in places):
                places.append(at)
        poses = [Pose(x_m=float(x), y_m=float(y), yaw_deg=float(self._rng.uniform(-180.0, 180.0))) for x, y in places]
        return [self._posed(name, pose, number) for name, pose in zip(self.fleet.robot, poses, strict=True)]

    def _posed(self, name: str, pose: Pose, number: int) -> Posed:
        depth_m, lens_rows = self.fleet.robot[name].depth_m, lens_of(self.calibration.camera, None)
        surface_m, sigma = self.fleet.tank.surface_m, sigma_of(self.calibration)
        where = Where(pose, depth_m, surface_m, self.fleet.body, *lens_rows, sigma, None)
        known, best = CoverageMap(self._grid), None
        by = ahead(where, self._grid, known.cells, frozenset(), ())
        for k in range(DRAWS):
            best = better(best, drawn(where, name, number, k), by)
        assert isinstance(best, Best)
        view = best.candidate.view
        eye = Eye(np.array(place_m(view.place)), np.array(rotation(view.turn)))
        return Posed(name, pose, Attitude(depth_m, 0.0, 0.0), best.candidate, eye)

    def scene_of(self, one: Posed) -> FrameScene:
        """What its view is expected to show, of a map in which nothing is known."""
        return frame_scene(one.view.view, self._grid, {}, frozenset())

    def lent(self, one: Posed, posed: Sequence[Posed]) -> tuple[str, ...]:
        """Whose lamps the rule has burn for its view, of those whose gimbals reach it."""
        scene, place = self.scene_of(one), self._aim.place_m
        reach = [other for other in posed if other is one or self._aim.at(scene.aim_m, other.pose, other.level)[1]]
        lamps = {other.name: Lamp(place(other.pose, other.level)) for other in reach}
        return tuple(allocate_frame(one.name, scene, lamps, self.lighting).lamps)

    def beam(self, one: Posed, at_m: Sequence[float] | None = None) -> LampBeam:
        """Its lamp, aimed there; None: as it goes with the camera."""
        lamp_m = np.array(self._aim.place_m(one.pose, one.level))
        ahead_m = np.asarray(one.eye.position_m) + AHEAD_M * np.asarray(one.eye.rotation)[:, 2]
        way = (ahead_m if at_m is None else np.array(at_m)) - lamp_m
        return LampBeam(lamp_m, way / np.linalg.norm(way), 1.0)

    def moment(self, one: Posed, posed: Sequence[Posed], lamps: Sequence[LampBeam]) -> Moment:
        hulls = [self._hull(other) for other in posed if other is not one]
        return Moment(one.eye, self.solids, hulls, self.tags, lamps=tuple(lamps), own_hull=self._hull(one))

    def _hull(self, one: Posed) -> Hull:
        yaw, z_m = math.radians(one.pose.yaw_deg), self.fleet.tank.surface_m - one.level.depth_m
        c, s = math.cos(yaw), math.sin(yaw)
        return Hull(np.array((one.pose.x_m, one.pose.y_m, z_m)), np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))))

    def keyframe(self, one: Posed, posed: Sequence[Posed]) -> Row:
        """One sweep by each policy's lamps: blocks that are right and wrong, and whether the rule borrowed light."""
        aim_m, by_rule = self.scene_of(one).aim_m, self.lent(one, posed)
        beams = {f"{other.name} ahead": self.beam(other) for other in posed}
        beams |= {other.name: self.beam(other, aim_m) for other in posed if other is one or other.name in by_rule}
        all_ahead = [f"{other.name} ahead" for other in posed]
        sets = {"ahead": [f"{one.name} ahead"], "own": [one.name], "all": all_ahead, "rule": list(by_rule)}
        truth_m = self._truth_m(one, posed)
        found = {policy: self._judged(sweep, truth_m) for policy, sweep in self._swept(one, posed, beams, sets).items()}
        return {"lent": set(by_rule) != {one.name}, **found}

    def _swept(
        self, one: Posed, posed: Sequence[Posed], beams: Mapping[str, LampBeam], sets: Mapping[str, Sequence[str]]
    ) -> dict[str, BlockSweep]:
        camera, positions = self.calibration.camera, self._positions()
        plan = SweepPlan(sweep=1, focus=positions, block_px=block_px(camera))
        middle_m = self.lens.at_position_m(positions[len(positions) // 2])
        exposures = {  # locked by the robot that sweeps
            policy: self.painter.metered(self.moment(one, posed, [beams[lamp] for lamp in lamps]), middle_m)
            for policy, lamps in sets.items()
        }
        sweeps = {policy: BlockSweep(plan, camera) for policy in sets}
        for tick, position in enumerate(positions):
            sensor_m = self.lens.at_position_m(position)
            light = {
                name: self.painter.light(self.moment(one, posed, [beam]), sensor_m) for name, beam in beams.items()
            }
            for policy, lamps in sets.items():
                total = np.ascontiguousarray(sum(light[lamp] for lamp in lamps))
                sweeps[policy].add(self.painter.develop(total, exposures[policy], tick=tick), position, tick)
        return sweeps

    def _positions(self) -> tuple[int, ...]:
        return full_positions(self.calibration.focus, self.fleet.camera.sweep_steps)

    def _truth_m(self, one: Posed, posed: Sequence[Posed]) -> Array:
        """Depth of each block; nan: it is one of another robot, or has an edge in it."""
        side, sensor_m = block_px(self.calibration.camera), self.lens.at_position_m(self._positions()[-1])

        def blocks(hulls: Sequence[Hull]) -> Array:
            depth = np.asarray(self.painter.depth(one.eye, sensor_m, hulls))
            rows, cols = depth.shape[0] // side, depth.shape[1] // side
            cut = depth[: rows * side, : cols * side].reshape(rows, side, cols, side)
            return cut.swapaxes(1, 2).reshape(rows * cols, -1)

        seen, bare = blocks(self.moment(one, posed, ()).hulls), blocks(())
        middle = np.median(seen, axis=1)
        torn = np.ptp(seen, axis=1) > 0.25 * middle
        return np.where(np.any(seen != bare, axis=1) | torn, np.nan, middle)

    def _judged(self, sweep: BlockSweep, truth_m: Array) -> list[int]:
        """Blocks whose peak is about where they are, and blocks whose peak is elsewhere."""
        fit, right, wrong = self.calibration.focus, 0, 0
        for k, position, sigma in sweep.peaks().peaks:
            z_m, nearer_m = h(fit, position), h(fit, position + sigma)
            if np.isnan(truth_m[k]) or z_m is None or nearer_m is None:
                continue
            if abs(z_m - truth_m[k]) > max(NEAR_ENOUGH * truth_m[k], 3.0 * abs(nearer_m - z_m)):
                wrong += 1
            elif NEAREST_M < truth_m[k] < FARTHEST_M:
                right += 1
        return [right, wrong]


# --- the claim ---

POLICIES = ("ahead", "own", "all", "rule")
CASES = ("harbour", "bay")


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    fleets: int = 4  # drawn places of three robots


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Three keyframes a fleet. Raises CalibrationRefused."""
    basin = Basin(case, seed)
    fleets = [basin.robots(number) for number in range(settings.fleets)]
    return [basin.keyframe(one, posed) for posed in fleets for one in posed]


def summary(rows: Rows) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for water, frames in rows.items():
        right = {policy: mean([frame[policy][0] for frame in frames]) for policy in POLICIES}
        lent = [frame for frame in frames if frame["lent"]]
        of_lent = {policy: mean([frame[policy][0] for frame in lent]) for policy in ("own", "rule")}
        found |= {f"{water}_{policy}": blocks for policy, blocks in right.items()}
        found |= {
            f"{water}_gain": ratio(right["rule"], right["own"]),
            f"{water}_lent": 100.0 * len(lent) / len(frames),
            f"{water}_lent_gain": ratio(of_lent["rule"], of_lent["own"]),
            f"{water}_wrong": mean([frame["rule"][1] for frame in frames]),
        }
    return found


def mean(values: Sequence[int]) -> float | None:
    return sum(values) / len(values) if values else None


def ratio(one: float | None, other: float | None) -> float | None:
    return one / other if one is not None and other else None


def figures(water: str) -> tuple[Figure, ...]:
    return (
        Figure(f"{water}_rule", f"{water}: blocks a keyframe by the rule", "of 475"),
        Figure(f"{water}_wrong", "blocks that are wrong"),
        Figure(f"{water}_own", "by the own lamp, aimed at the view"),
        Figure(f"{water}_ahead", "by the own lamp, aimed a metre ahead"),
        Figure(f"{water}_all", "by all lamps, each with its camera"),
        Figure(f"{water}_gain", "the rule's over the own lamp's"),
        Figure(f"{water}_lent", "keyframes for which the rule borrows light", "% of all"),
        Figure(f"{water}_lent_gain", "the rule's over the own lamp's in these"),
    )


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"fleets": 1},
    cases=CASES,
    measured_on="twin",
    figures=(*figures("harbour"), *figures("bay")),
    explanation="""A robot at rest sweeps its focus over a whole view of a dark basin. What counts are blocks of the
        picture that get a depth, within 5 % of the true one or three standard deviations. The rule lends lamps by what
        they are expected to show. Each seed is another lens, other things on the floor and other places of robots; the
        rule is set by seed 0.""",
)
