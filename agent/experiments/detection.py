"""Is the ball found, where it is, in every kind of water, and not where it is not?

In each water a number of places, spread over several worlds; from each place the ball sharp and defocused, and the same
views without it; each picture as the camera gives it and enhanced. A frame counts when it shows 120 deg of the outline;
found is what lies within a fifth of the radius of the truth, and everything else that is called a ball is false.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from agent.core.config import WaterKind
from agent.core.ranging.camera_model import CameraFit
from agent.experiments.experiment import DEFAULT_SENSOR, WATERS, ExperimentResult, Row, Sensor
from agent.experiments.still_camera import StillCamera, TankView
from agent.perception.detection.detect import Ball, find_ball
from agent.perception.enhancement.enhance import classic, enhance, raw_else_enhanced
from agent.process.command import Progress
from hw.camera.camera import Image
from hw.twin.optics.raycast import Floats
from hw.twin.scene import SceneWater, Solid, generator, load_scene

# --- views of a ball, with its true outline in the picture ---
# A world is one tank of water with one ball and two stones; of each view there is also the picture without the ball.
# The truth is taken from the twin's own depth, with and without the ball: it knows of refraction, distortion, focus
# breathing and of what stands in front, and of nothing that a detector does.

Array = NDArray[np.float64]
T = TypeVar("T", bound=np.generic)

WATER_INDEX = 1.333
BALL_RADIUS_M = 0.07
RANGE_M = (0.25, 1.5)  # camera to the ball's centre
HEIGHT_M = (0.05, 0.40)  # of the camera above the floor
ASIDE_DEG = (9.0, 6.0)  # the camera looks at most so far past the ball, sideways and up or down
TANK_M, MARGIN_M = (1.5, 1.2), 0.03  # the camera keeps this distance from the walls
DEFOCUS = 300  # of 1023 lens positions: a defocused picture is at least so far from the sharp one
SECTORS = 96  # of the outline, to say how much of it is visible


class Outline(NamedTuple):
    """Where a ball is in a picture: the cone through its visible border."""

    centre_px: tuple[float, float]  # of the ray to the ball's centre
    radius_px: float  # apparent angular radius times f_px
    visible: float  # share of the outline that the picture shows


class BallView(NamedTuple):
    """One frame with the ball and one without it, from the same place at the same focus."""

    with_ball: Image
    without: Image
    camera: CameraFit  # the pinhole nearest to this lens at this focus
    truth: Outline | None  # None where the ball is hidden or less than a tenth of its outline shows
    range_m: float
    sharp: bool


def ball_views(water: WaterKind, sensor: Sensor, seed: int, count: int) -> Iterator[BallView]:
    """`count` places in one world, each seen sharp and defocused; the same arguments give the same pictures."""
    rng = generator(seed, water, "views")
    ball_m = (rng.uniform(0.2, 0.4), rng.uniform(0.2, 0.4), BALL_RADIUS_M)  # near a corner: some views are long
    stones = tuple(
        Solid(kind="stone", position_m=(float(x), float(y), 0.05), radii_m=(0.08, 0.05, 0.06))
        for x, y in rng.uniform((0.55, 0.55), (1.4, 1.1), (2, 2))
    )
    ball = Solid(kind="ball", position_m=ball_m, radii_m=(BALL_RADIUS_M,) * 3)
    tank = msgspec.structs.replace(load_scene("tank"), water=SceneWater(preset=water))
    full = StillCamera(sensor, seed, scene=msgspec.structs.replace(tank, solid=(ball, *stones)))
    bare = StillCamera(sensor, seed, scene=msgspec.structs.replace(tank, solid=stones))
    for camera in (full, bare):
        camera.prepare()
    for _ in range(count):
        view, range_m = _view(np.array(ball_m), rng)
        sharp = _sharp_position(full, range_m - BALL_RADIUS_M)
        away = rng.uniform(full.lens.lowest, full.lens.highest - 2 * DEFOCUS)
        blurred = int(away if away < sharp - DEFOCUS else max(away, sharp - DEFOCUS) + 2 * DEFOCUS)
        for lens_position in (sharp, min(blurred, full.lens.highest)):
            yield _ball_view(full, bare, view, lens_position, range_m, lens_position == sharp)


def _view(ball_m: Array, rng: np.random.Generator) -> tuple[TankView, float]:
    """A place in the tank from which the ball can be seen, and its distance from there."""
    while True:
        range_m, azimuth, height_m = rng.uniform(*RANGE_M), rng.uniform(0.0, 2.0 * math.pi), rng.uniform(*HEIGHT_M)
        drop_m = ball_m[2] - height_m
        flat_m = math.sqrt(max(range_m**2 - drop_m**2, 0.0))
        x, y = ball_m[:2] - flat_m * np.array([math.cos(azimuth), math.sin(azimuth)])
        inside = all(MARGIN_M < at < side - MARGIN_M for at, side in zip((x, y), TANK_M, strict=True))
        if inside and flat_m > 0.5 * range_m:
            break
    yaw_deg = math.degrees(azimuth) + rng.uniform(-ASIDE_DEG[0], ASIDE_DEG[0])
    tilt_deg = math.degrees(math.atan2(drop_m, flat_m)) + rng.uniform(-ASIDE_DEG[1], ASIDE_DEG[1])
    return TankView((float(x), float(y), height_m), yaw_deg, tilt_deg), range_m


def _sharp_position(camera: StillCamera, distance_m: float) -> int:
    """Lens position at which a thing so far away is sharp, without the port's few millimetres."""
    lens = camera.lens
    lens_position = (lens.image_m(WATER_INDEX / distance_m) - lens.at_rest_m) / lens.per_position_m
    return round(min(max(lens_position, lens.lowest), lens.highest))


def _ball_view(
    full: StillCamera, bare: StillCamera, view: TankView, lens_position: int, range_m: float, sharp: bool
) -> BallView:
    """The two frames, and the truth from their depths."""
    images, depths = [], []
    for camera in (full, bare):
        camera.view = view
        camera.set_focus(lens_position)
        images.append(camera.read(settle_s=0.2).image)
        depths.append(camera.truth_m(lens_position))
    lens, (width, height) = full.lens, full.size
    f_px = WATER_INDEX * lens.at_position_m(lens_position) / lens.pixel_m
    pinhole = CameraFit(width_px=width, height_px=height, f_px=f_px, cx_px=lens.centre_px[0], cy_px=lens.centre_px[1])
    return BallView(images[0], images[1], pinhole, outline(depths[0], depths[1], pinhole), range_m, sharp)


def outline(depth_m: Floats, without_m: Floats, camera: CameraFit) -> Outline | None:
    """The cone m . g = 1 through the border between ball and background; depths (height, width) with and without it.

    Where the neighbour is nearer than the ball, the border belongs to what stands in front, and does not count.
    """
    ball = depth_m < without_m
    points = []
    for axis in (0, 1):
        first, second = _pairs(ball, axis)
        near, far = _pairs(depth_m, axis)
        limb = (first != second) & np.where(first, far > near, near > far)
        v, u = np.nonzero(limb)
        points.append(np.column_stack([u + 0.5 * axis, v + 0.5 * (1 - axis)]))
    border = np.concatenate(points)
    if len(border) < SECTORS // 10:
        return None
    rays = np.column_stack([(border - (camera.cx_px, camera.cy_px)) / camera.f_px, np.ones(len(border))])
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    g = np.linalg.lstsq(rays, np.ones(len(rays)), rcond=None)[0]
    u, v = camera.f_px * g[:2] / g[2] + (camera.cx_px, camera.cy_px)
    turn = np.arctan2(border[:, 1] - v, border[:, 0] - u) / (2.0 * math.pi) + 0.5
    visible = len(np.unique((turn * SECTORS).astype(int) % SECTORS)) / SECTORS
    if visible < 0.1 or not np.linalg.norm(g) > 1.0:
        return None
    return Outline((float(u), float(v)), camera.f_px * math.acos(1.0 / float(np.linalg.norm(g))), visible)


def _pairs(values: NDArray[T], axis: int) -> tuple[NDArray[T], NDArray[T]]:
    """Each pixel but the last along an axis, and its neighbour."""
    return (values[:-1], values[1:]) if axis == 0 else (values[:, :-1], values[:, 1:])


# --- the experiment ---

Find = Callable[[Image, CameraFit], Ball | None]

IMAGES: dict[str, Find] = {
    "raw": find_ball,
    "classic": lambda image, camera: find_ball(classic(image), camera),
    "enhanced": lambda image, camera: find_ball(enhance(image), camera),
    "raw, else enhanced": lambda image, camera: raw_else_enhanced(
        lambda shown: find_ball(shown, camera), image, lambda: enhance(image)
    ),
}
WORLDS = 10  # tanks of each kind of water: its veil differs from tank to tank by a factor of six
RANGES_M = ((0.25, 0.4), (0.4, 0.8), (0.8, 1.5), (0.25, 1.5))
ENOUGH = 1 / 3  # of the outline
NEAR_ENOUGH = 0.2  # of the radius, in centre and in radius
ERRORS = ("centre_median_px", "centre_p95_px", "radius_bias_px", "radius_p95_px")


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # the first world; the others follow it
    count: int = 200  # places in each kind of water
    sensor: Sensor = DEFAULT_SENSOR
    waters: tuple[WaterKind, ...] = WATERS


class Result(ExperimentResult, frozen=True, kw_only=True):
    """A row in `cases` for each water, image, focus and stretch of range."""

    schema: int = 1
    source: str = "twin"
    seed: int
    sensor: str
    places: int
    cases: list[Row]


class Outcome(NamedTuple):
    """What the detector said of one view."""

    water: str
    image: str
    sharp: bool
    range_m: float
    counts: bool  # the frame shows enough of the ball
    found: bool
    false: int  # a ball beside the ball, or in the picture without one: 0 to 2
    centre_px: float  # errors; nan where it was not found
    radius_px: float


def run(settings: Settings, progress: Progress) -> Result:
    """Look for the ball in each water; progress counts places."""
    outcomes: list[Outcome] = []
    done, total = 0, settings.count * len(settings.waters)
    progress(done, total)
    for water in settings.waters:
        for world in range(min(WORLDS, settings.count)):
            places = len(range(world, settings.count, WORLDS))
            for k, view in enumerate(ball_views(water, settings.sensor, settings.seed + world, places)):
                outcomes += [outcome(view, water, name, find) for name, find in IMAGES.items()]
                done += k % 2  # a place is seen twice
                progress(done, total)
    return Result(seed=settings.seed, sensor=settings.sensor, places=settings.count, cases=cases(outcomes))


def outcome(view: BallView, water: str, name: str, find: Find) -> Outcome:
    """One view, with the ball and without it, looked at in one way."""
    truth = view.truth
    ball = find(view.with_ball, view.camera)
    elsewhere = find(view.without, view.camera)
    counts = truth is not None and truth.visible >= ENOUGH
    centre_px, radius_px, right = math.nan, math.nan, False
    if ball and truth:
        centre_px, radius_px = math.dist(ball.centre_px, truth.centre_px), ball.radius_px - truth.radius_px
        right = max(centre_px, abs(radius_px)) < NEAR_ENOUGH * ball.radius_px
    false = int(ball is not None and not right) + int(elsewhere is not None)
    if not right:
        centre_px = radius_px = math.nan
    return Outcome(water, name, view.sharp, view.range_m, counts, right, false, centre_px, radius_px)


def cases(outcomes: list[Outcome]) -> list[Row]:
    """One row per water, image, focus and stretch of range."""
    rows = []
    for water, image in dict.fromkeys((one.water, one.image) for one in outcomes):
        for sharp in (True, False):
            for low, high in RANGES_M:
                group = [
                    one
                    for one in outcomes
                    if (one.water, one.image, one.sharp) == (water, image, sharp) and low <= one.range_m < high
                ]
                case = {"water": water, "image": image, "focus": "sharp" if sharp else "defocused"}
                rows.append({**case, "range_m": [low, high], **summary(group)})
    return rows


def summary(group: list[Outcome]) -> Row:
    """Rates and errors of a group."""
    counted = [one for one in group if one.counts]
    centre = np.array([one.centre_px for one in counted if one.found])
    radius = np.array([one.radius_px for one in counted if one.found])
    values: list[float | None] = [None] * len(ERRORS)
    if len(centre):
        size = np.abs(radius)
        measures = np.median(centre), np.quantile(centre, 0.95), np.median(radius), np.quantile(size, 0.95)
        values = [float(value) for value in measures]
    return {
        "frames": len(counted),
        "found": len(centre),
        "rate": len(centre) / len(counted) if counted else None,
        "pictures": 2 * len(group),  # with the ball and without it
        "false": sum(one.false for one in group),
        **dict(zip(ERRORS, values, strict=True)),
    }


# --- table ---


def table(result: Result) -> Table:
    """Rates and errors over all ranges: a line for each water, image and focus."""
    shown = Table(title=f"{result.sensor}, {result.places} places in each water, 0.25 to 1.5 m")
    for column in ("water", "image", "focus"):
        shown.add_column(column)
    for column in ("found", "false", "centre px", "95 %", "radius px", "95 %"):
        shown.add_column(column, justify="right")
    for case in result.cases:
        if tuple(case["range_m"]) != RANGES_M[-1]:
            continue
        shown.add_row(
            case["water"],
            case["image"],
            case["focus"],
            f"{case['found']}/{case['frames']}",
            f"{case['false']}/{case['pictures']}",
            *("-" if case[name] is None else f"{case[name]:.2f}" for name in ERRORS),
        )
    return shown
