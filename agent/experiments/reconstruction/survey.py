"""How much of a basin's floor three robots know that swim and survey it, after each minute in virtual time.

What a sweep's blocks measure is the truth of the drawn scene from where the camera truly was at its end, with noise. No
frames are rendered, nothing is hidden but by things, and no robot is seen.
"""

from __future__ import annotations

import math

import msgspec
import numpy as np

from agent.capabilities.survey.coverage_map import STEEPEST, CoverageMap, grid_of
from agent.capabilities.survey.survey import NOISIER, surveyor_of
from agent.core.config import Coverage, Fleet, Pose, Survey
from agent.core.ranging.camera_model import CameraFit
from agent.core.ranging.focus import as_on_axis, lens_position, phase_sigma
from agent.core.step_io import BlockPeaks, SweepPlan
from agent.experiments.claim import Claim, Figure, Row, Rows, Value
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import CAMERA, START_NS, Bodies, PlanarBodies
from agent.experiments.navigation.swimmers import FOCUS, LATE_STEPS, Eyes, Frame, Swimmers
from agent.experiments.reconstruction.coverage import Scene, block_shares, draw_scene, found_in, look
from hw.twin.camera_device import look as eye_of
from hw.twin.scene import generator

WIDE = msgspec.structs.replace(CAMERA, f_px=867.0, bend=0.41)  # of the twin's camera binned_640
THINGS = 8
STARTS = ((0.5, 0.5, 45.0), (2.5, 0.5, 135.0), (1.5, 1.5, 270.0))  # x, y, yaw of each robot
STEPS_S = 20
SHOWS = 0.85  # of the blocks have texture enough for a peak: 373 to 410 of 475 in a rendered dive
OUTLIERS = 200  # one block in so many, by keyframes of a rendered dive
WRONG_M = (0.2, 0.3)  # depths that such a one has: near the lens's nearest


class WideBodies(PlanarBodies):
    """Robots in the plane whose cameras see as much as those of the survey's twin."""

    def camera(self, name: str) -> CameraFit:
        return WIDE


class SurveyEyes(Eyes):
    """One robot's camera before drawn things; while the lens moves nothing else is seen."""

    def __init__(self, fleet: Fleet, name: str, bodies: WideBodies, scene: Scene) -> None:
        super().__init__(fleet, name, bodies, None)
        self._camera_m, self._scene = fleet.body.camera_m, scene
        self._rng = generator(fleet.twin.seed, name, "drawn blocks")

    def expose(self, bodies: Bodies, name: str, step: int, sees_tags: bool) -> None:
        plan = self._plan
        if plan is None or not plan.block_px:
            super().expose(bodies, name, step, sees_tags)
            return
        self._index += 1
        if self._index == len(plan.focus) - 1:
            self._plan = None
            self.coming.append(Frame(step + LATE_STEPS, blocks=self._blocks(bodies, name, plan)))

    def _blocks(self, bodies: Bodies, name: str, plan: SweepPlan) -> BlockPeaks:
        eye, _ = eye_of(bodies.pose(name), self._camera_m)
        side, camera, rng = plan.block_px, bodies.camera(name), self._rng
        seen = look(self._scene, np.array(eye.position_m), np.array(eye.rotation), camera, side)
        own = math.hypot(FOCUS.noise, phase_sigma(FOCUS.width, side * side))
        peaks, shares = [], block_shares(camera, side)
        for k, z_m in enumerate(seen.z_m):
            shows = 0.12 < z_m < 1.6 and seen.cos[k] > STEEPEST and rng.random() < SHOWS
            wrong = rng.random() < 1.0 / OUTLIERS
            if shows:
                true_m = float(rng.uniform(*WRONG_M)) if wrong else float(z_m)
                off = NOISIER * own * float(rng.normal())
                peaks.append((k, lens_position(FOCUS, as_on_axis(true_m, shares[k])) + off, NOISIER * own))
        return found_in(plan, camera, side, peaks, bodies.now_ns)


def swimming_fleet(seed: int) -> Fleet:
    """Three robots that survey the floor of the basin of the experiment on navigation."""
    poses = [Pose(x_m=x, y_m=y, yaw_deg=yaw) for x, y, yaw in STARTS]
    coverage = Coverage(goal_mm=10.0, cell_mm=50.0, share=1.0, faces=("floor",))
    return msgspec.structs.replace(basin.linked(poses, seed, does=[Survey()] * len(poses)), coverage=coverage)


def swum(seed: int, seconds: float, every_s: float) -> Row:
    """known: share of the floor's cells that all keyframes together know, after each every_s; keyframes: of all robots;
    things: cells away from floor and walls in which the map has something, and empty: of these, how many in which
    nothing is, a cell's width around."""
    fleet = swimming_fleet(seed)
    bodies = WideBodies(fleet)
    length, breadth, _ = basin.TANK.size_m
    scene = draw_scene((length, breadth, basin.TANK.surface_m), seed, THINGS)
    world = Swimmers(fleet, bodies)
    world.eyes = {name: SurveyEyes(fleet, name, bodies, scene) for name in fleet.robot}
    known = CoverageMap(grid_of(fleet))
    made, shares = dict.fromkeys(fleet.robot, 0), list[float]()
    for step in range(1, round(seconds * STEPS_S) + 1):
        world.step()
        for name, agent in world.agents.items():
            own = surveyor_of(agent.capabilities)
            if own is not None and own.keyframes > made[name]:
                made[name] = own.keyframes
                known.add(own.known.held[name, START_NS][own.keyframes].frame)
        if step % round(every_s * STEPS_S) == 0:
            shares.append(floor_share(known))
    wanted = known.solid()
    return {
        "known": shares,
        "keyframes": sum(made.values()),
        "things": len(wanted),
        "empty": sum(not near_a_thing(number, known, scene) for number in wanted),
    }


def floor_share(known: CoverageMap) -> float:
    """Of the wanted cells."""
    wanted = known.grid.wanted
    return sum(known.cells.get(number, 0) >= known.grid.goal for number in wanted) / len(wanted)


def near_a_thing(number: int, known: CoverageMap, scene: Scene) -> bool:
    """Whether any of 13 x 13 x 13 places in a cell, and a cell's width around it, lies in one of the scene's bodies."""
    (nx, ny, _), cell_m = known.grid.shape, known.grid.cell_m
    index = np.array([number % nx, number // nx % ny, number // (nx * ny)], float)
    steps = np.linspace(-1.0, 2.0, 13)
    places = (index + np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)) * cell_m
    for body in scene.bodies:
        inner = ((places - body.centre_m) @ body.turn.T) / body.half_m
        size = (inner * inner).sum(axis=1) if body.round else np.abs(inner).max(axis=1)
        if (size < 1.0).any():
            return True
    return False


# --- the claim ---

MINUTES = 5


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    minutes: int = MINUTES  # at most so many


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    return [swum(seed, 60.0 * settings.minutes, 60.0)]


def summary(rows: Rows) -> dict[str, Value]:
    """Means over the seeds, in per cent; of things, of all seeds' cells together."""
    swims = rows["all"]
    known = np.mean([row["known"] for row in swims], axis=0).tolist()
    things = sum(row["things"] for row in swims)
    return {
        **{f"known_{n}": 100.0 * share for n, share in enumerate(known, 1)},
        "keyframes": float(np.mean([row["keyframes"] for row in swims])),
        "empty": 100.0 * sum(row["empty"] for row in swims) / things if things else None,
    }


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"minutes": 1},
    measured_on="twin",
    figures=(
        *(Figure(f"known_{n}", f"of the floor known to 10 mm after {n} min", "%") for n in range(1, MINUTES + 1)),
        Figure("keyframes", "keyframes of all robots until then"),
        Figure("empty", "cells of things in which nothing is, nor beside them", "%"),
    ),
    explanation="""Three robots swim in a basin of 3 x 2 m and choose where to look next; each tells the others what it
        saw and which view it takes. A cell of the floor is known once the keyframes of all robots together tell its
        depth to 10 mm. Each seed draws other things on the floor, bodies, tethers, tags and noise; one block of a
        sweep in 200 is quite wrong, which puts things on the map that are not there.""",
)
