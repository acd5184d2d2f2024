"""Is the ball found, where it is, in every kind of water, and not where it is not?

In each world a number of places; from each place the ball sharp and defocused, and the same views without it; each
picture as the camera gives it and enhanced.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple, TypeVar, get_args

import msgspec
import numpy as np
from numpy.typing import NDArray

from agent.core.config import WaterKind
from agent.core.ranging.camera_model import CameraFit
from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value, percentile
from agent.experiments.still_camera import WATER_INDEX, StillCamera, TankView
from agent.perception.detection.detect import Ball, find_ball
from agent.perception.enhancement.enhance import classic, enhance, one_thread, raw_else_enhanced
from hw.camera.camera import Image
from hw.twin.optics.raycast import Floats
from hw.twin.scene import SceneWater, Solid, generator, load_scene

# --- views of a ball, with its true outline in the picture ---
# A world is one tank of water with one ball and two stones; of each view there is also the picture without the ball.
# The truth is taken from the twin's own depth, with and without the ball: it knows of refraction, distortion, focus
# breathing and of what stands in front, and of nothing that a detector does.

Array = NDArray[np.float64]
T = TypeVar("T", bound=np.generic)

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
    sharp: bool


def ball_views(water: WaterKind, sensor: str, seed: int, count: int) -> Iterator[BallView]:
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
            yield _ball_view(full, bare, view, lens_position, lens_position == sharp)


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


def _ball_view(full: StillCamera, bare: StillCamera, view: TankView, lens_position: int, sharp: bool) -> BallView:
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
    return BallView(images[0], images[1], pinhole, outline(depths[0], depths[1], pinhole), sharp)


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


# --- what is found in a view ---

WAYS = {
    "raw": "raw frames",
    "classic": "white balance and CLAHE",
    "enhanced": "frames enhanced by the network",
    "either": "raw, else enhanced, as a robot does",
}
ENOUGH = 1 / 3  # of the outline
NEAR_ENOUGH = 0.2  # of the radius, in centre and in radius


def balls(image: Image, camera: CameraFit) -> dict[str, Ball | None]:
    """The ball that each way finds in a picture."""
    clear = enhance(image)
    return {
        "raw": find_ball(image, camera),
        "classic": find_ball(classic(image), camera),
        "enhanced": find_ball(clear, camera),
        "either": raw_else_enhanced(lambda shown: find_ball(shown, camera), image, lambda: clear),
    }


def errors_px(truth: Outline | None, ball: Ball | None) -> tuple[float, float] | None:
    """Of centre and radius, of a ball that is the true one."""
    if not ball or not truth:
        return None
    centre_px, radius_px = math.dist(ball.centre_px, truth.centre_px), ball.radius_px - truth.radius_px
    return (centre_px, radius_px) if max(centre_px, abs(radius_px)) < NEAR_ENOUGH * ball.radius_px else None


# --- the claim ---

FOCI = ("sharp", "defocused")


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    places: int = 20  # in a world
    sensor: str = "imx519_640"  # a preset of hw.twin.optics.lens


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One tank of this water; a row for each way and focus."""
    one_thread()  # so that the network's sums come out the same
    rows = {(way, focus): empty(way, focus) for way in WAYS for focus in FOCI}
    for view in ball_views(msgspec.convert(case, WaterKind), settings.sensor, seed, settings.places):
        found, elsewhere = balls(view.with_ball, view.camera), balls(view.without, view.camera)
        for way in WAYS:
            add(rows[way, FOCI[0] if view.sharp else FOCI[1]], view.truth, found[way], elsewhere[way])
    return list(rows.values())


def empty(way: str, focus: str) -> Row:
    counts = {"frames": 0, "found": 0, "pictures": 0, "false": 0}
    return {"way": way, "focus": focus, **counts, "centre_px": [], "radius_px": []}


def add(row: Row, truth: Outline | None, ball: Ball | None, elsewhere: Ball | None) -> None:
    """A view. `ball`: what was found in the picture with the ball; `elsewhere`: in the one without."""
    errors = errors_px(truth, ball)
    row["pictures"] += 2
    row["false"] += int(ball is not None and errors is None) + int(elsewhere is not None)
    if truth is None or truth.visible < ENOUGH:
        return
    row["frames"] += 1
    if errors:
        row["found"] += 1
        row["centre_px"].append(errors[0])
        row["radius_px"].append(errors[1])


def summary(rows: Rows) -> dict[str, Value]:
    """Over all kinds of water; of raw frames, how many are found in each."""
    figures: dict[str, Value] = {}
    for water, of_water in rows.items():
        figures[f"{water}_found"] = share([row for row in of_water if row["way"] == "raw"], "found", "frames")
    everything = [row for of_water in rows.values() for row in of_water]
    for way in WAYS:
        of_way = [row for row in everything if row["way"] == way]
        figures[f"{way}_false"] = share(of_way, "false", "pictures")
        for focus in FOCI:
            group = [row for row in of_way if row["focus"] == focus]
            figures[f"{way}_{focus}_found"] = share(group, "found", "frames")
            centre_px, radius_px = ([px for row in group for px in row[key]] for key in ("centre_px", "radius_px"))
            figures[f"{way}_{focus}_centre_px"] = percentile(centre_px, 95.0)
            figures[f"{way}_{focus}_radius_px"] = percentile(radius_px, 50.0)
    return figures


def share(rows: list[Row], hits: str, of: str) -> Share:
    return Share(sum(row[hits] for row in rows), sum(row[of] for row in rows))


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"places": 1},
    cases=get_args(WaterKind),
    measured_on="twin",
    figures=(
        *(Figure(f"{water}_found", f"balls found in raw frames, {water}", "%") for water in get_args(WaterKind)),
        *(
            Figure(f"{way}_{focus}_{key}", f"{words}, {focus}: {of}", unit)
            for way, words in WAYS.items()
            for key, of, unit in (
                ("found", "balls found", "%"),
                ("centre_px", "centre off, 95 %", "px"),
                ("radius_px", "radius off, median", "px"),
            )
            for focus in FOCI
        ),
        *(Figure(f"{way}_false", f"{words}: something else is called a ball", "%") for way, words in WAYS.items()),
    ),
    seeds=10,  # a veil differs from tank to tank by a factor of six
    explanation="""A red ball in a tank of each kind of water, from 0.25 to 1.5 m, some of it behind a stone or cut off
        by the frame; from each place sharp, and defocused by at least 300 of 1023 lens positions, and the same views
        without it. A frame counts when it shows 120 degrees of the outline; found is what lies within a fifth of the
        radius of the truth, in centre and in radius. Each seed is another tank, lens and set of places.""",
)
