"""Sweeps of all stations in virtual time, and what a robot makes of them; truth from the painter's ray caster.

Each robot's lens is calibrated on a wall first, with the sweep and the blocks that measure later. Cameras stand still
and their poses are exact; `noisy.py` makes them worse.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.config import WaterKind
from agent.core.ranging.camera_model import Calibration
from agent.experiments.choices import Sensor
from agent.experiments.depth.wall import calibrate, sweeps_of_a_calibration
from agent.experiments.reconstruction.intrinsics import camera_of
from agent.experiments.reconstruction.world import (
    MOORED,
    Station,
    held_back_known,
    held_back_new,
    scene_of_seed,
    trained,
)
from agent.experiments.still_camera import StillCamera
from agent.experiments.sweeps import breathing, lens_positions, sweep
from agent.reconstruction.views import View, diagonal_prior, keyframe
from hw.twin.scene import Scene

EXACT = diagonal_prior(1e-5, 1e-5)
TRUTH_STEP = 4  # of the full picture's pixels one in so many, across and down, has its true depth kept

Views = list[View]
Truth = NDArray[np.float32]  # (height, width) of one in TRUTH_STEP pixels: z-depth, m


@dataclass(frozen=True, eq=False)
class Rendered:
    """What one tank in one water gave. Truth depths belong to `trained`, in its order."""

    seed: int
    water: WaterKind
    scene: Scene
    trained: Views
    known: Views  # held back, from stations that are trained on
    new: Views  # held back, from others
    truth_m: list[Truth]


def sweeps_of_a_world() -> int:
    """How often `render` sweeps."""
    return len(MOORED) * sweeps_of_a_calibration() + len(trained()) + len(held_back_known()) + len(held_back_new())


def render(seed: int, water: WaterKind, sensor: Sensor, step: Callable[[], None]) -> Rendered:
    """Every view of one tank; `step` is called after each sweep."""
    scene = scene_of_seed(seed, water)
    found: dict[str, Views] = {"trained": [], "known": [], "new": []}
    truth = []
    for robot in MOORED:
        known = calibrated(robot, seed, sensor, scene, step)
        camera = StillCamera(sensor, seed, robot, scene)
        camera.prepare()
        groups = {"trained": trained(), "known": held_back_known(), "new": held_back_new()}
        for group, stations in groups.items():
            for seq, station in enumerate(stations):
                if station.robot == robot:
                    found[group].append(seen(camera, station, seq, known))
                    if group == "trained":
                        truth.append(camera.truth_m(known.camera.lens)[::TRUTH_STEP, ::TRUTH_STEP].copy())
                    step()
    return Rendered(seed, water, scene, found["trained"], found["known"], found["new"], truth)


def calibrated(robot: str, seed: int, sensor: Sensor, scene: Scene, step: Callable[[], None]) -> Calibration:
    """This robot's lens, measured before a wall; its picture, the best that the model can say of the twin's."""
    bench = StillCamera(sensor, seed, robot, msgspec.structs.replace(scene, solid=()))
    bench.prepare()
    focus = calibrate(bench, breathing(bench), step)
    fit = camera_of(bench.lens, float(bench.lens.highest))
    return Calibration(robot=robot, made="", source="wall", focus=focus, camera=fit)


def seen(camera: StillCamera, station: Station, seq: int, known: Calibration) -> View:
    """One sweep from a station."""
    camera.view = station.view
    images, rho = sweep(camera), np.array(lens_positions(camera), float)
    swept = keyframe(images, rho, known, math.radians(station.view.tilt_deg))
    return View(
        robot=station.robot,
        incarnation="",
        seq=seq,
        camera=swept.camera,
        rotation=rotation_of_view(station.view.yaw_deg, station.view.tilt_deg),
        position_m=np.array(station.view.position_m),
        pose_covariance=EXACT,
        picture=swept.picture,
        depth_m=swept.depth.depth_m,
        sigma_m=swept.depth.sigma_m,
    )


def rotation_of_view(yaw_deg: float, tilt_deg: float) -> NDArray[np.float64]:
    """(3, 3) camera (right, down, ahead) to world."""
    yaw, tilt = math.radians(yaw_deg), math.radians(tilt_deg)
    ahead = np.array([math.cos(yaw) * math.cos(tilt), math.sin(yaw) * math.cos(tilt), math.sin(tilt)])
    right = np.array([math.sin(yaw), -math.cos(yaw), 0.0])
    return np.stack([right, np.cross(ahead, right), ahead], axis=1)


def truth_points(rendered: Rendered) -> Sequence[NDArray[np.float64]]:
    """Of each trained view the places (n, 3) that it truly sees, world."""
    from agent.reconstruction.views import to_world, unproject

    points = []
    for view, depth in zip(rendered.trained, rendered.truth_m, strict=True):
        v, u = np.mgrid[: depth.shape[0], : depth.shape[1]] * float(TRUTH_STEP)
        times = TRUTH_STEP  # pictures of views are TRUTH_STEP times smaller: back to their pixels
        pixels = (np.stack([u, v], axis=-1) - (times - 1) / 2.0) / times
        points.append(to_world(view, unproject(view.camera, pixels, depth.astype(float))).reshape(-1, 3))
    return points
