"""One tank and its stations, sweeps of all stations in virtual time, and what a robot makes of them; truth from the
painter's ray caster.

Each robot's lens is calibrated on a wall first, with the sweep and the blocks that measure later. Cameras stand still
and their poses are exact; `noisy` makes them worse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from agent.core.config import WaterKind
from agent.core.ranging.camera_model import Calibration, CameraFit
from agent.experiments.depth import calibrate
from agent.experiments.still_camera import (
    WATER_INDEX,
    StillCamera,
    TankView,
    breathing,
    lens_positions,
    rotation_of_view,
    sweep,
)
from agent.reconstruction.pose_evidence import moved_about
from agent.reconstruction.views import (
    Camera,
    Floats,
    FocusMap,
    View,
    diagonal_prior,
    keyframe,
    moved,
    project,
    reduction,
)
from hw.twin.optics.lens import Lens
from hw.twin.optics.raycast import Optics, ray
from hw.twin.scene import Scene, Solid, generator, load_scene

# --- the tank of one seed, and where cameras stand: five moored robots, and five other places ---

BALL_M = 0.07
STONES = 4
# Robots of the paper's tank (agent/fleets/tank.toml): x, y, yaw.
MOORED = {
    "r1": (0.30, 0.25, 34.0),
    "r2": (1.25, 0.30, 152.0),
    "r3": (0.70, 1.05, 277.0),
    "r4": (1.28, 0.85, 209.0),
    "r5": (0.20, 0.75, 341.0),
}
DEPTHS_M = (0.10, 0.22, 0.36)
TILTS_DEG = (-32.0, -20.0, -8.0)  # one for each depth: lower cameras look less far down
PANS_DEG = (-30.0, 0.0, 30.0)
SURFACE_M = 0.5
BOX_M = np.array([1.5, 1.2, SURFACE_M])  # of the water, as in that file
# Held back: each robot once more between its pans (depth, pan), and a place where none was (x, y, yaw, depth, tilt).
BETWEEN = {"r1": (0.16, 15.0), "r2": (0.28, -15.0), "r3": (0.16, -15.0), "r4": (0.28, 15.0), "r5": (0.22, 15.0)}
NEW = {
    "r1": (0.75, 0.18, 92.0, 0.15, -28.0),
    "r2": (1.35, 0.60, 178.0, 0.22, -18.0),
    "r3": (1.00, 1.05, 245.0, 0.20, -22.0),
    "r4": (0.45, 0.55, 20.0, 0.12, -30.0),
    "r5": (0.40, 1.05, 310.0, 0.28, -14.0),
}
CLEAR_M = 0.17  # from the middle of a stone to the middle of a camera, across


def scene_of_seed(seed: int, water: WaterKind) -> Scene:
    """The paper's tank of seed 0; other seeds have their ball and stones drawn, clear of every station."""
    tank = load_scene("tank")
    kind = msgspec.structs.replace(tank.water, preset=water)
    return msgspec.structs.replace(tank, water=kind, solid=tank.solid if seed == 0 else drawn_solids(seed))


def drawn_solids(seed: int) -> tuple[Solid, ...]:
    """A ball and STONES stones of any shape on the floor, none in another or in a camera."""
    rng, solids = generator(seed, "reconstruction", "solids"), list[Solid]()
    places = [place[:2] for place in (*MOORED.values(), *NEW.values())]
    while len(solids) <= STONES:
        x, y = rng.uniform(0.3, 1.2), rng.uniform(0.25, 0.95)
        radii = (BALL_M,) * 3 if not solids else tuple(rng.uniform(0.04, 0.09, 3).tolist())
        near = max(radii[0], radii[1])
        free = all(math.hypot(x - px, y - py) > CLEAR_M for px, py in places)
        apart = all(math.dist((x, y), s.position_m[:2]) > near + max(s.radii_m[:2]) + 0.01 for s in solids)
        if free and apart:
            height = radii[2] * (1.0 if not solids else rng.uniform(0.5, 0.9))
            kind = "stone" if solids else "ball"
            solids.append(msgspec.convert({"kind": kind, "position_m": (x, y, height), "radii_m": radii}, Solid))
    return tuple(solids)


def trained(robot: str) -> list[TankView]:
    """At three depths, turned three ways."""
    x, y, yaw = MOORED[robot]
    return [
        TankView((x, y, SURFACE_M - depth), yaw + pan, tilt)
        for depth, tilt in zip(DEPTHS_M, TILTS_DEG, strict=True)
        for pan in PANS_DEG
    ]


def held_back(robot: str) -> tuple[TankView, TankView]:
    """Views that are not trained on: from where the robot stands, and from where no robot was."""
    (x, y, yaw), (depth, pan) = MOORED[robot], BETWEEN[robot]
    known = TankView((x, y, SURFACE_M - depth), yaw + pan, float(np.interp(depth, DEPTHS_M, TILTS_DEG)))
    x, y, yaw, depth, tilt = NEW[robot]
    return known, TankView((x, y, SURFACE_M - depth), yaw, tilt)


# --- the camera model that fits a twin's lens and flat port best ---

NEAR_M, FAR_M = 0.25, 1.3


def camera_of(lens: Lens, lens_position: float) -> CameraFit:
    """Least squares over pixels and ranges, from the data sheet's camera, with the lens at rest at that position: exact
    but for what the model cannot express."""
    pixels, points = _rays(lens, lens_position)
    f = WATER_INDEX * lens.at_position_m(lens_position) / lens.pixel_m

    def off(numbers: Floats) -> Floats:
        f_px, cx, cy, bend, ahead = numbers.tolist()
        return (project(Camera(f_px, cx, cy, bend, ahead, lens.width, lens.height), points) - pixels).ravel()

    fit = least_squares(off, [f, *lens.centre_px, 0.39, 0.0], x_scale=[1e-3 * f, 1.0, 1.0, 1e-2, 1e-3])
    found = dict(zip(("f_px", "cx_px", "cy_px", "bend", "ahead_m"), fit.x.tolist(), strict=True))
    return CameraFit(
        width_px=lens.width,
        height_px=lens.height,
        lens=lens_position,
        breathing=lens.per_position_m / lens.at_position_m(lens_position),
        noise_px=max(float(np.sqrt(np.mean(fit.fun**2))), 1e-3),
        **found,
    )


def _rays(lens: Lens, lens_position: float) -> tuple[Floats, Floats]:
    """Pixels (n, 2) and points of the camera frame (n, 3) that the twin's own rays join."""
    slope = lens.pixel_m / lens.at_position_m(lens_position)
    optics = Optics(slope, *lens.centre_px, lens.k1, lens.k2, WATER_INDEX**2, lens.port_gap_m)
    pixels, points = [], []
    for i in np.linspace(0, lens.width - 1, 17).round().astype(int).tolist():
        for j in np.linspace(0, lens.height - 1, 13).round().astype(int).tolist():
            mx, my, a, b = (float(value) for value in ray.py_func(optics, i, j))  # type: ignore[attr-defined]
            for depth in 1.0 / np.linspace(1.0 / FAR_M, 1.0 / NEAR_M, 6):
                pixels.append((i, j))
                points.append((a + depth * mx, b + depth * my, depth))
    return np.array(pixels, float), np.array(points)


# --- sweeps of all stations ---

EXACT = diagonal_prior(1e-5, 1e-5)


@dataclass(frozen=True, eq=False)
class Rendered:
    """What one tank in one water gave."""

    scene: Scene
    trained: list[View]
    true: list[View]  # the same with the depths of each pixel that are true
    known: list[View]  # held back, from stations that are trained on
    new: list[View]  # held back, from others


def render(seed: int, water: WaterKind, sensor: str, robots: int = len(MOORED)) -> Rendered:
    """Every view of one tank by its first robots."""
    found = Rendered(scene_of_seed(seed, water), [], [], [], [])
    for robot in list(MOORED)[:robots]:
        calibration = calibrated(robot, seed, sensor, found.scene)
        camera = StillCamera(sensor, seed, robot, found.scene)
        camera.prepare()
        times = reduction(camera.lens.width)
        every = np.s_[times // 2 :: times]  # pixels of which a picture's are made: those in the middle
        for seq, stand in enumerate(trained(robot)):
            view = seen(camera, stand, robot, seq, calibration)
            truth_m = camera.truth_m(calibration.camera.lens)[every, every].astype(np.float32)
            found.trained.append(view)
            found.true.append(replace(view, depth_m=truth_m))
        known, new = held_back(robot)
        found.known.append(seen(camera, known, robot, 0, calibration))
        found.new.append(seen(camera, new, robot, 0, calibration))
    return found


def calibrated(robot: str, seed: int, sensor: str, scene: Scene) -> Calibration:
    """This robot's lens, measured before a wall; its picture, the best that the model can say of the twin's."""
    bench = StillCamera(sensor, seed, robot, msgspec.structs.replace(scene, solid=()))
    bench.prepare()
    focus = calibrate(bench, breathing(bench))
    fit = camera_of(bench.lens, float(bench.lens.highest))
    return Calibration(robot=robot, made="", source="wall", focus=focus, camera=fit)


def seen(camera: StillCamera, stand: TankView, robot: str, seq: int, known: Calibration) -> View:
    """One sweep."""
    camera.view = stand
    images, rho = sweep(camera), np.array(lens_positions(camera), float)
    swept = keyframe(images, rho, known, math.radians(stand.tilt_deg))
    return view_from(stand, robot, seq, swept.camera, swept.picture, swept.depth)


def view_from(
    stand: TankView, robot: str, seq: int, camera: Camera, picture: NDArray[np.float32], depth: FocusMap
) -> View:
    """A keyframe whose pose is known."""
    return View(
        robot=robot,
        incarnation="",
        seq=seq,
        camera=camera,
        rotation=rotation_of_view(stand.yaw_deg, stand.tilt_deg),
        position_m=np.array(stand.position_m),
        pose_covariance=EXACT,
        picture=picture,
        depth_m=depth.depth_m,
        sigma_m=depth.sigma_m,
    )


# --- poses as wrong as a survey leaves them: an error that all views of a robot share, and one of each view ---

SHARED = (3e-3, math.radians(0.5))  # of a robot: m and rad, standard deviations along and about each axis
OWN = (0.7e-3, math.radians(0.08))  # of a view besides


def noisy(views: Sequence[View], seed: int) -> list[View]:
    """The same views as their robots would believe them to be; a robot turns about the middle of its views."""
    found = []
    for robot in sorted({view.robot for view in views}):
        rng = generator(seed, "reconstruction", "poses", robot)
        turn, shift = rng.normal(0.0, SHARED[1], 3), rng.normal(0.0, SHARED[0], 3)
        middle = np.mean([view.position_m for view in views if view.robot == robot], axis=0)
        found += [_off(view, turn, shift, middle, rng) for view in views if view.robot == robot]
    order = {view.key: n for n, view in enumerate(views)}
    return sorted(found, key=lambda view: order[view.key])


def _off(view: View, turn: Floats, shift: Floats, middle: Floats, rng: np.random.Generator) -> View:
    there = moved_about(view, middle, turn, shift)
    w, t = rng.normal(0.0, OWN[1], 3), rng.normal(0.0, OWN[0], 3)
    shared, own = (diagonal_prior(angle_rad, place_m) for place_m, angle_rad in (SHARED, OWN))
    return replace(moved(there, w, t), pose_covariance=shared, own_covariance=own)
