"""`aucamp experiment detection`: is the ball found, where it is, in every kind of water, and not where it is not.

In each water so many places, spread over several worlds; from each the ball sharp and defocused and the same view
without it; each picture as the camera gives it and enhanced. A frame counts when it shows 120 deg of the outline;
found is what lies within a fifth of the radius of the truth, and everything else that is called a ball is false.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from agent.experiments.ball_views import WATERS, BallView, ball_views, check_views
from agent.experiments.result import make_room, write_result
from agent.launch import run_folder, with_bar
from agent.perception.clear_view import raw_else_enhanced
from agent.perception.detect import Ball, find_ball
from agent.perception.enhance import enhance
from agent.perception.grey_world import classic
from agent.ranging.calibration import CameraFit
from hw.camera import Image

Progress = Callable[[int, int], None]  # places done, places in all
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


class Look(NamedTuple):
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


def detection(
    seed: int, count: int, sensor: str, out: Path, progress: Progress, waters: Sequence[str] = WATERS
) -> dict[str, Any]:
    """`count` places in each water; writes result.json into `out` and returns its content.

    Raises ConfigError for a sensor or a water that does not exist, or where `out` holds a result already.
    """
    check_views(sensor, waters)
    make_room(out)
    looks: list[Look] = []
    done = 0
    progress(done, count * len(waters))
    for water in waters:
        for world in range(min(WORLDS, count)):
            places = len(range(world, count, WORLDS))
            for k, view in enumerate(ball_views(water, sensor, seed + world, places)):
                looks += [look(view, water, name, find) for name, find in IMAGES.items()]
                done += k % 2  # a place is seen twice
                progress(done, count * len(waters))
    result = {"schema": 1, "source": "twin", "seed": seed, "sensor": sensor, "places": count, "cases": cases(looks)}
    write_result(out, result)
    return result


def look(view: BallView, water: str, name: str, find: Find) -> Look:
    truth = view.truth
    ball = find(view.with_ball, view.camera)
    elsewhere = find(view.without, view.camera)
    counts = truth is not None and truth.visible >= ENOUGH
    centre_px, radius_px, right = math.nan, math.nan, False
    if ball and truth:
        centre_px, radius_px = math.dist(ball.centre_px, truth.centre_px), ball.radius_px - truth.radius_px
        right = agree(ball, centre_px, radius_px)
    false = int(ball is not None and not right) + int(elsewhere is not None)
    if not right:
        centre_px = radius_px = math.nan
    return Look(water, name, view.sharp, view.range_m, counts, right, false, centre_px, radius_px)


def agree(ball: Ball, centre_px: float, radius_px: float) -> bool:
    return max(centre_px, abs(radius_px)) < NEAR_ENOUGH * ball.radius_px


def cases(looks: list[Look]) -> list[dict[str, Any]]:
    """One row per water, image, focus and stretch of range."""
    found = []
    for water, image in dict.fromkeys((one.water, one.image) for one in looks):
        for sharp in (True, False):
            for low, high in RANGES_M:
                group = [
                    one
                    for one in looks
                    if (one.water, one.image, one.sharp) == (water, image, sharp) and low <= one.range_m < high
                ]
                case = {"water": water, "image": image, "focus": "sharp" if sharp else "defocused"}
                found.append({**case, "range_m": [low, high], **figures(group)})
    return found


def figures(group: list[Look]) -> dict[str, Any]:
    counted = [one for one in group if one.counts]
    centre = np.array([one.centre_px for one in counted if one.found])
    radius = np.array([one.radius_px for one in counted if one.found])
    names = ("centre_median_px", "centre_p95_px", "radius_bias_px", "radius_p95_px")
    values: list[float | None] = [None] * len(names)
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
        **dict(zip(names, values, strict=True)),
    }


def run(
    seed: int, count: int, sensor: str, out: Path | None, console: Console, waters: Sequence[str] | None = None
) -> dict[str, Any]:
    """Run the experiment into `out` or runs/<UTC>, print the table over all ranges; returns result.json's content."""
    folder = run_folder(out)
    result = with_bar(console, "places", lambda show: detection(seed, count, sensor, folder, show, waters or WATERS))
    console.print(table(result))
    console.print(f"written to {folder}")
    return result


def table(result: dict[str, Any]) -> Table:
    shown = Table(title=f"{result['sensor']}, {result['places']} places in each water, 0.25 to 1.5 m")
    for column in ("water", "image", "focus"):
        shown.add_column(column)
    for column in ("found", "false", "centre px", "95 %", "radius px", "95 %"):
        shown.add_column(column, justify="right")
    for case in result["cases"]:
        if tuple(case["range_m"]) != RANGES_M[-1]:
            continue
        names = ("centre_median_px", "centre_p95_px", "radius_bias_px", "radius_p95_px")
        shown.add_row(
            case["water"],
            case["image"],
            case["focus"],
            f"{case['found']}/{case['frames']}",
            f"{case['false']}/{case['pictures']}",
            *("-" if case[name] is None else f"{case[name]:.2f}" for name in names),
        )
    return shown
