"""Is the ball found, where it is, in every kind of water, and not where it is not?

In each water so many places, spread over several worlds; from each the ball sharp and defocused and the same view
without it; each picture as the camera gives it and enhanced. A frame counts when it shows 120 deg of the outline;
found is what lies within a fifth of the radius of the truth, and everything else that is called a ball is false.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np

from agent.core.config import WaterKind
from agent.core.ranging.camera_model import CameraFit
from agent.experiments.choices import DEFAULT_SENSOR, WATERS, Sensor
from agent.experiments.detection.ball_views import BallView, ball_views
from agent.experiments.result import ExperimentResult, Row
from agent.perception.detection.detect import Ball, find_ball
from agent.perception.enhancement.enhance import classic, enhance, raw_else_enhanced
from agent.process.command import Progress
from hw.camera.camera import Image

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
