"""Views of a dark basin that a survey would take, each swept by any set of lamps: rendered, robots at rest.

Three robots stand in a basin with drawn things on its floor. Each takes the view that would tell a robot most that
knows nothing yet (coverage/candidates.py). Light adds up, so each lamp is rendered once for each lens position, and
any set of them is a sum, exposed as the camera would.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.capabilities.light.allocate import AHEAD_M, Aim, FrameChoice, FrameScene, Lamp, aim_of, allocate_frame
from agent.capabilities.survey.candidates import Best, Candidate, Where, ahead, better, drawn, frame_scene
from agent.capabilities.survey.coverage_map import FARTHEST_M, NEAREST_M, CoverageMap, Grid, grid_of, place_m, rotation
from agent.capabilities.survey.survey import block_px, lens_of, sigma_of
from agent.core.attitude import Attitude
from agent.core.config import Fleet, Lighting, Pose, WaterOptics
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration
from agent.core.ranging.focus import h
from agent.core.ranging.sweep import full_positions
from agent.core.step_io import SweepPlan
from agent.experiments.ball_measurements import PosedRobot
from agent.perception.depth_sweep import BlockSweep
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from hw.twin.optics.lens import draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.optics.raycast import Eye, Hull, LampBeam, Moment
from hw.twin.scene import Solid, generator, in_daylight, load_scene
from hw.twin.truth import true_tags

WATERS = {
    "harbour": ((0.55, 0.37, 0.45), (1.82, 1.82, 1.82)),
    "bay": ((0.40, 0.25, 0.40), (0.80, 0.80, 0.80)),
}
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


class Swept(NamedTuple):
    """One sweep by one set of lamps."""

    asked: int  # blocks whose true depth would count
    right: int  # of them, whose peak is about there
    wrong: int  # peaks that are elsewhere
    depths_m: Array  # true, of each block
    good: NDArray[np.bool_]  # which blocks are right


class Basin:
    """One world: basin, things, lens, water."""

    def __init__(self, water: str, seed: int) -> None:
        absorption, scattering = WATERS[water]
        self.lighting = Lighting(water=WaterOptics(absorption_per_m=absorption, scattering_per_m=scattering))
        fleet, scene = load_fleet(fleet_file("survey")), load_scene("survey")
        robots = {name: replace(robot, lamp=True) for name, robot in fleet.robot.items()}
        twin = replace(fleet.twin, seed=seed)
        self.fleet: Fleet = replace(fleet, lighting=self.lighting, robot=robots, twin=twin)
        wet = replace(scene.water, absorption_per_m=absorption, scattering_per_m=scattering)
        self._rng = np.random.default_rng((seed, 23))
        self.solids = tuple(self._things())
        self.scene = replace(scene, room_light=0.0, water=wet, solid=self.solids)
        self.calibration = calibrated(self.fleet)
        self.lens = draw_lens(scene.camera, generator(seed, "r1", "lens"))
        tags = true_tags(fleet.landmarks, seed)
        index = fleet.water.refractive_index
        self.tags = tags
        self.painter = Painter(self.scene, fleet.tank, index, self.lens, seed, "r1", tags)
        self.painter.prepare()
        self.aim: Aim = aim_of(self.fleet, self.lighting)
        self.grid: Grid = grid_of(self.fleet)

    def _things(self) -> Iterator[Solid]:
        length, breadth, _ = self.fleet.tank.size_m
        for k in range(THINGS):
            half = self._rng.uniform((0.04, 0.03, 0.03), (0.12, 0.10, 0.07))
            x, y = self._rng.uniform((0.15, 0.15), (length - 0.15, breadth - 0.15))
            turn = tuple(float(deg) for deg in self._rng.uniform((-180.0, -15.0, -15.0), (180.0, 15.0, 15.0)))
            radii = (float(half[0]), float(half[1]), float(half[2]))
            kind = "stone" if k % 2 else "box"
            yield Solid(kind=kind, position_m=(float(x), float(y), radii[2]), radii_m=radii, turn_deg=turn)

    def robots(self, number: int) -> dict[str, Posed]:
        """Three at drawn places, each with its view."""
        length, breadth, _ = self.fleet.tank.size_m
        places: list[Array] = []
        while len(places) < len(self.fleet.robot):
            at = self._rng.uniform((FROM_WALL_M, FROM_WALL_M), (length - FROM_WALL_M, breadth - FROM_WALL_M))
            if all(np.hypot(*(at - other)) >= APART_M for other in places):
                places.append(at)
        posed = {}
        for name, (x, y) in zip(self.fleet.robot, places, strict=True):
            pose = Pose(x_m=float(x), y_m=float(y), yaw_deg=float(self._rng.uniform(-180.0, 180.0)))
            posed[name] = self._posed(name, pose, number)
        return posed

    def _posed(self, name: str, pose: Pose, number: int) -> Posed:
        robot, lens_rows = self.fleet.robot[name], lens_of(self.calibration.camera, None)
        surface_m, sigma = self.fleet.tank.surface_m, sigma_of(self.calibration)
        where = Where(pose, robot.depth_m, surface_m, self.fleet.body, *lens_rows, sigma, None)
        known, best = CoverageMap(self.grid), None
        by = ahead(where, self.grid, known.cells, frozenset(), ())
        for k in range(DRAWS):
            best = better(best, drawn(where, name, number, k), by)
        assert isinstance(best, Best)
        view = best.candidate
        eye = Eye(np.array(place_m(view.view.place)), np.array(rotation(view.view.turn)))
        return Posed(name, pose, Attitude(robot.depth_m, 0.0, 0.0), view, eye)

    def beam(self, one: Posed, at_m: Vector) -> LampBeam:
        """Its lamp, aimed there."""
        lamp_m = np.array(self.aim.place_m(one.pose, one.level))
        way = np.array(at_m) - lamp_m
        return LampBeam(lamp_m, way / np.linalg.norm(way), 1.0)

    def scene_of(self, one: Posed) -> FrameScene:
        """What its view is expected to show, of a map in which nothing is known."""
        return frame_scene(one.view.view, self.grid, {}, frozenset())

    def chosen(self, one: Posed, posed: Mapping[str, Posed]) -> FrameChoice:
        """Whose lamps the rule has burn for its view, of those whose gimbals reach it."""
        scene = self.scene_of(one)
        lamps = {
            name: Lamp(self.aim.place_m(other.pose, other.level))
            for name, other in posed.items()
            if other is one or self.aim.at(scene.aim_m, other.pose, other.level)[1]
        }
        return allocate_frame(one.name, scene, lamps, self.lighting)

    def ahead_m(self, one: Posed) -> Vector:
        """What its own lamp goes with."""
        x, y, z = np.asarray(one.eye.position_m) + AHEAD_M * np.asarray(one.eye.rotation)[:, 2]
        return float(x), float(y), float(z)

    def moment(self, one: Posed, posed: Mapping[str, Posed], lamps: Sequence[LampBeam]) -> Moment:
        hulls = [Hull(self._body_m(other), turn(other)) for other in posed.values() if other is not one]
        middle = Moment(one.eye, self.solids, hulls, self.tags, lamps=tuple(lamps))
        return middle._replace(own_hull=Hull(self._body_m(one), turn(one)))

    def _body_m(self, one: Posed) -> Array:
        return np.array((one.pose.x_m, one.pose.y_m, self.fleet.tank.surface_m - one.level.depth_m))

    def swept(
        self,
        one: Posed,
        posed: Mapping[str, Posed],
        beams: Mapping[str, LampBeam],
        sets: dict[str, Sequence[str]],
        halfway: dict[str, Sequence[str]] | None = None,
    ) -> dict[str, Swept]:
        """One sweep by each of the sets of these beams; halfway: those of them that burn in its second half."""
        fit, camera = self.calibration.focus, self.calibration.camera
        side = block_px(camera)
        positions = full_positions(fit, self.fleet.camera.sweep_steps)
        plan = SweepPlan(sweep=1, focus=positions, block_px=side)
        middle_m = self.lens.at_position_m(positions[len(positions) // 2])
        exposures = {  # locked by whoever sweeps
            key: self.painter.metered(self.moment(one, posed, [beams[lamp] for lamp in lamps]), middle_m)
            for key, lamps in sets.items()
        }
        sweeps = {key: BlockSweep(plan, camera) for key in sets}
        used = sorted({lamp for lamps in sets.values() for lamp in lamps})
        for tick, position in enumerate(positions):
            sensor_m = self.lens.at_position_m(position)
            light = {lamp: self.painter.light(self.moment(one, posed, [beams[lamp]]), sensor_m) for lamp in used}
            later = {} if halfway is None or 2 * tick < len(positions) else halfway
            for key, lamps in (sets | later).items():
                total = np.ascontiguousarray(sum(light[lamp] for lamp in lamps))
                sweeps[key].add(self.painter.develop(total, exposures[key], tick=tick), position, tick)
        truth = self._truth_m(one, posed, self.lens.at_position_m(positions[-1]), side)
        return {key: self._judged(sweep, truth) for key, sweep in sweeps.items()}

    def _truth_m(self, one: Posed, posed: Mapping[str, Posed], sensor_m: float, side: int) -> Array:
        """Depth of each block; nan: it is one of another robot, or has an edge in it."""
        hulls = self.moment(one, posed, ()).hulls
        with_hulls = self.painter.depth(one.eye, sensor_m, hulls)
        without = self.painter.depth(one.eye, sensor_m)
        rows, cols = with_hulls.shape[0] // side, with_hulls.shape[1] // side
        cut = np.s_[: rows * side, : cols * side]
        blocks, bare = (
            np.asarray(depth)[cut].reshape(rows, side, cols, side).swapaxes(1, 2).reshape(rows * cols, -1)
            for depth in (with_hulls, without)
        )
        middle = np.median(blocks, axis=1)
        hidden = np.any(blocks != bare, axis=1)
        torn = np.ptp(blocks, axis=1) > 0.25 * middle
        return np.where(hidden | torn, np.nan, middle)

    def _judged(self, sweep: BlockSweep, truth_m: Array) -> Swept:
        fit, good, wrong = self.calibration.focus, np.zeros(truth_m.shape, bool), 0
        asked = (truth_m > NEAREST_M) & (truth_m < FARTHEST_M)
        for k, position, sigma in sweep.peaks().peaks:
            z_m, nearer_m = h(fit, position), h(fit, position + sigma)
            if np.isnan(truth_m[k]) or z_m is None or nearer_m is None:
                continue
            off_m, may_m = abs(z_m - truth_m[k]), max(NEAR_ENOUGH * truth_m[k], 3.0 * abs(nearer_m - z_m))
            if off_m > may_m:
                wrong += 1
            elif asked[k]:
                good[k] = True
        return Swept(int(asked.sum()), int(good.sum()), wrong, truth_m, good)


def turn(one: Posed) -> Array:
    yaw = math.radians(one.pose.yaw_deg)
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


def calibrated(fleet: Fleet) -> Calibration:
    """By the bench's procedure, in daylight and without the fleet's things."""
    scene = in_daylight(replace(load_scene("survey"), solid=()))
    return PosedRobot(fleet, "r1", scene.camera).calibrate()
