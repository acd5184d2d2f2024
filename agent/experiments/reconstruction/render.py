"""One tank and its stations, sweeps of all stations in virtual time, and what a robot makes of them; truth from the
painter's ray caster.

Each robot's lens is calibrated on a wall first, with the sweep and the blocks that measure later. Cameras stand still
and their poses are exact; `noisy` makes them worse.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import msgspec
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from agent.core.config import WaterKind
from agent.core.ranging.camera_model import Calibration, CameraFit
from agent.experiments.depth import calibrate
from agent.experiments.still_camera import WATER_INDEX, StillCamera, TankView, breathing, lens_positions, sweep
from agent.reconstruction.pose_evidence import moved_about
from agent.reconstruction.views import (
    Camera,
    Floats,
    View,
    diagonal_prior,
    keyframe,
    moved,
    project,
    reduction,
    to_world,
    unproject,
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
# Held back: each robot once more between its pans, and five places where none was.
BETWEEN = {"r1": (0.16, 15.0), "r2": (0.28, -15.0), "r3": (0.16, -15.0), "r4": (0.28, 15.0), "r5": (0.22, 15.0)}
NEW = (
    (0.75, 0.18, 92.0, 0.15, -28.0),
    (1.35, 0.60, 178.0, 0.22, -18.0),
    (1.00, 1.05, 245.0, 0.20, -22.0),
    (0.45, 0.55, 20.0, 0.12, -30.0),
    (0.40, 1.05, 310.0, 0.28, -14.0),
)
CLEAR_M = 0.17  # from the middle of a stone to the middle of a camera, across


class Station(NamedTuple):
    """One view: which robot's camera takes it, where it stands and looks."""

    robot: str
    view: TankView


def scene_of_seed(seed: int, water: WaterKind) -> Scene:
    """The paper's tank of seed 0; other seeds have their ball and stones drawn, clear of every station."""
    tank = load_scene("tank")
    kind = msgspec.structs.replace(tank.water, preset=water)
    return msgspec.structs.replace(tank, water=kind, solid=tank.solid if seed == 0 else drawn_solids(seed))


def drawn_solids(seed: int) -> tuple[Solid, ...]:
    """A ball and STONES stones of any shape on the floor, none in another or in a camera."""
    rng, solids = generator(seed, "reconstruction", "solids"), list[Solid]()
    places = [*((x, y) for x, y, _ in MOORED.values()), *((x, y) for x, y, *_ in NEW)]
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


def trained() -> list[Station]:
    """45 views: every robot at three depths, turned three ways."""
    return [
        Station(robot, TankView((x, y, SURFACE_M - depth), yaw + pan, tilt))
        for robot, (x, y, yaw) in MOORED.items()
        for depth, tilt in zip(DEPTHS_M, TILTS_DEG, strict=True)
        for pan in PANS_DEG
    ]


def held_back_known() -> list[Station]:
    """A view of each robot that is not trained on, from where it stands."""
    found = []
    for robot, (depth, pan) in BETWEEN.items():
        x, y, yaw = MOORED[robot]
        tilt = float(np.interp(depth, DEPTHS_M, TILTS_DEG))
        found.append(Station(robot, TankView((x, y, SURFACE_M - depth), yaw + pan, tilt)))
    return found


def held_back_new() -> list[Station]:
    """Views from where no robot was; with the camera of the robot of that number."""
    return [
        Station(robot, TankView((x, y, SURFACE_M - depth), yaw, tilt))
        for robot, (x, y, yaw, depth, tilt) in zip(MOORED, NEW, strict=True)
    ]


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
    f_px, cx, cy, bend, ahead = fit.x.tolist()
    return CameraFit(
        width_px=lens.width,
        height_px=lens.height,
        f_px=f_px,
        cx_px=cx,
        cy_px=cy,
        bend=bend,
        ahead_m=ahead,
        lens=lens_position,
        breathing=lens.per_position_m / lens.at_position_m(lens_position),
        noise_px=max(float(np.sqrt(np.mean(fit.fun**2))), 1e-3),
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

Views = list[View]
Truth = NDArray[np.float32]  # (height, width) z-depth, m


@dataclass(frozen=True, eq=False)
class Rendered:
    """What one tank in one water gave. Truth depths belong to `trained`, in its order."""

    scene: Scene
    trained: Views
    known: Views  # held back, from stations that are trained on
    new: Views  # held back, from others
    truth_m: list[Truth]
    times: int  # so many times as large are pictures in which one pixel in so many, across and down, has its truth kept


def render(seed: int, water: WaterKind, sensor: str, robots: int = len(MOORED)) -> Rendered:
    """Every view of one tank by its first robots."""
    scene = scene_of_seed(seed, water)
    groups = {"trained": trained(), "known": held_back_known(), "new": held_back_new()}
    found: dict[str, Views] = {group: [] for group in groups}
    truth = []
    for robot in list(MOORED)[:robots]:
        known = calibrated(robot, seed, sensor, scene)
        camera = StillCamera(sensor, seed, robot, scene)
        camera.prepare()
        times = reduction(camera.lens.width)
        for group, stations in groups.items():
            for seq, station in enumerate(stations):
                if station.robot != robot:
                    continue
                found[group].append(seen(camera, station, seq, known))
                if group == "trained":
                    truth.append(camera.truth_m(known.camera.lens)[::times, ::times].copy())
    return Rendered(scene, found["trained"], found["known"], found["new"], truth, times)


def calibrated(robot: str, seed: int, sensor: str, scene: Scene) -> Calibration:
    """This robot's lens, measured before a wall; its picture, the best that the model can say of the twin's."""
    bench = StillCamera(sensor, seed, robot, msgspec.structs.replace(scene, solid=()))
    bench.prepare()
    focus = calibrate(bench, breathing(bench))
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
    points = []
    for view, depth in zip(rendered.trained, rendered.truth_m, strict=True):
        v, u = np.mgrid[: depth.shape[0], : depth.shape[1]]
        pixels = np.stack([u, v], axis=-1) - 0.5 * (1.0 - 1.0 / rendered.times)  # the first of each square that is one
        points.append(to_world(view, unproject(view.camera, pixels, depth.astype(float))).reshape(-1, 3))
    return points


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
    both = math.hypot(SHARED[1], OWN[1]), math.hypot(SHARED[0], OWN[0])
    return replace(moved(there, w, t), pose_covariance=diagonal_prior(*both))
