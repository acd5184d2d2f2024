"""How good are the eyes in a user's own water? Every picture of a folder is searched for balls of every colour.

Found is what lies, in centre and in radius, within a fifth of the radius of a marked ball of the colour, and besides
within the marking's own tolerance; everything else that is called a ball is false. Orange is what the rules of a known
contest call its red buoy: red found where orange is marked, or the other way round, is neither found nor false.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from agent.core.config import Colour
from agent.core.ranging.camera_model import CameraFit
from agent.experiments.detection.marked_pictures import COLOURS, MarkedBall, marked_pictures
from agent.experiments.result import ExperimentResult, Row
from agent.perception.detection.detect import Ball, find_balls
from agent.process.command import Progress, step_by_step
from hw.camera.camera import Image
from hw.picture_files import read_picture

NEAR_ENOUGH = 0.2  # of the radius, in centre and in radius, as on the twin
HFOV_DEG = 10.0
ALIKE = frozenset({"red", "orange"})
CLASSES_PX = ((0.0, 5.0), (5.0, 8.0), (8.0, 10.0), (10.0, 16.0), (16.0, math.inf))  # of the marked radius
# A target: what the size cue needs, and about what a dive of 0.07 m balls shows within 8 m.
JUDGED_PX = 10.0  # balls from this radius on
FOUND_SHARE = 0.9  # of them, in each colour
RADIUS_ERROR = 0.05  # their median, share of the radius


class Settings(Struct, frozen=True, kw_only=True):
    """What can be asked."""

    folder: Path


class Outcome(NamedTuple):
    """One marked ball, and what was found of it."""

    file: str
    marked: MarkedBall
    ball: Ball | None  # None: missed


class Seen(NamedTuple):
    """One picture: its marked balls with what was found of them, and what was called a ball beside."""

    path: Path
    outcomes: list[Outcome]
    false: list[tuple[Colour, Ball]]


class Result(ExperimentResult, frozen=True, kw_only=True):
    """Figures of each colour and radius; `missed` has the targets that are not reached."""

    schema: int = 1
    source: str = "pictures"
    folder: str
    pictures: int
    balls: dict[str, Row]  # by colour: marked, found, radius_error_median
    false: int
    by_radius: list[Row]  # the same by colour and stretch of marked radius
    within_sigma: list[float] | None  # share of found balls whose radius is within 1, 2, 3 of its stated sigma
    missed: list[str]
    cases: list[Row]  # each marked ball, and each false one
    shown: list[Seen]

    @property
    def failed(self) -> bool:
        return bool(self.missed)


def run(settings: Settings, progress: Progress) -> Result:
    """Search every picture for every colour; progress counts pictures. Raises ConfigError for what cannot be read."""
    pictures = marked_pictures(settings.folder)
    step = step_by_step(progress, len(pictures))
    seen = []
    for path, marked in pictures:
        seen.append(look(path, read_picture(path), marked))
        step()
    outcomes = [one for picture in seen for one in picture.outcomes]
    false = sum(len(picture.false) for picture in seen)
    return Result(
        folder=str(settings.folder),
        pictures=len(seen),
        balls={colour: rates([one for one in outcomes if one.marked.colour == colour]) for colour in COLOURS},
        false=false,
        by_radius=by_radius(outcomes),
        within_sigma=within_sigma(outcomes),
        missed=missed(outcomes, false),
        cases=[row for picture in seen for row in rows(picture)],
        shown=seen,
    )


def look(path: Path, image: Image, marked: Sequence[MarkedBall]) -> Seen:
    """One picture, searched for each colour."""
    camera = pinhole(image.shape[1], image.shape[0])
    outcomes: list[Outcome] = []
    false: list[tuple[Colour, Ball]] = []
    for colour in COLOURS:
        own = [ball for ball in marked if ball.colour == colour]
        balls = find_balls(image, camera, colour=colour)[: max(len(own), 1)]  # an agent takes the most convincing
        taken = matches(own, balls)
        outcomes += [Outcome(path.name, one, taken.get(k)) for k, one in enumerate(own)]
        excused = [ball for ball in marked if ball.colour == colour or {ball.colour, colour} <= ALIKE]
        false += [(colour, ball) for ball in balls if not any(distance(one, ball) <= 1.0 for one in excused)]
    return Seen(path, outcomes, false)


def pinhole(width_px: int, height_px: int) -> CameraFit:
    """The camera of a bare picture, which nobody calibrated."""
    f_px = 0.5 * width_px / math.tan(math.radians(0.5 * HFOV_DEG))
    centre = 0.5 * (width_px - 1), 0.5 * (height_px - 1)
    return CameraFit(width_px=width_px, height_px=height_px, f_px=f_px, cx_px=centre[0], cy_px=centre[1])


def distance(marked: MarkedBall, ball: Ball) -> float:
    """How far a ball is from a marked one: 1 at the limit of what counts as found."""
    off_px = max(math.dist(marked.centre_px, ball.centre_px), abs(marked.radius_px - ball.radius_px))
    return off_px / (NEAR_ENOUGH * marked.radius_px + marked.tolerance_px)


def matches(marked: Sequence[MarkedBall], balls: Sequence[Ball]) -> dict[int, Ball]:
    """The ball found for each marked one (by its place in the list), the nearest pairs first, none taken twice."""
    pairs = sorted((distance(one, ball), k, n) for k, one in enumerate(marked) for n, ball in enumerate(balls))
    taken: dict[int, int] = {}
    for far, k, n in pairs:
        if far <= 1.0 and k not in taken and n not in taken.values():
            taken[k] = n
    return {k: balls[n] for k, n in taken.items()}


def relative_error(one: Outcome) -> float:
    """|r - r_true| / r_true of a ball that was found."""
    assert one.ball is not None
    return abs(one.ball.radius_px - one.marked.radius_px) / one.marked.radius_px


def rates(outcomes: Sequence[Outcome]) -> Row:
    """How many of them were found, and how exactly."""
    errors = [relative_error(one) for one in outcomes if one.ball]
    median = float(np.median(errors)) if errors else None
    return {"marked": len(outcomes), "found": len(errors), "radius_error_median": median}


def by_radius(outcomes: Sequence[Outcome]) -> list[Row]:
    """Figures of each colour in each stretch of marked radius that has any."""
    table = []
    for colour in COLOURS:
        for low, high in CLASSES_PX:
            group = [o for o in outcomes if o.marked.colour == colour and low <= o.marked.radius_px < high]
            if group:
                radius_px = [low, None if math.isinf(high) else high]
                table.append({"colour": colour, "radius_px": radius_px, **rates(group)})
    return table


def within_sigma(outcomes: Sequence[Outcome]) -> list[float] | None:
    """Shares of the found balls whose radius errs by no more than 1, 2, 3 of its sigma, the marking's beside it."""
    ratios = [
        abs(one.ball.radius_px - one.marked.radius_px) / math.hypot(one.ball.radius_sigma_px, one.marked.tolerance_px)
        for one in outcomes
        if one.ball
    ]
    return [float(np.mean(np.array(ratios) <= k)) for k in (1, 2, 3)] if ratios else None


def missed(outcomes: Sequence[Outcome], false: int) -> list[str]:
    """Targets that are not reached, in words."""
    lines = [f"{false} called a ball and none"] if false else []
    for colour in COLOURS:
        group = [one for one in outcomes if one.marked.colour == colour and one.marked.radius_px >= JUDGED_PX]
        got = rates(group)
        if got["found"] < FOUND_SHARE * got["marked"]:
            lines.append(f"{colour}: {got['found']} of {got['marked']} from {JUDGED_PX:g} px radius found")
        if got["found"] and got["radius_error_median"] > RADIUS_ERROR:
            lines.append(f"{colour}: radius off by {100 * got['radius_error_median']:.1f} % in the median")
    return lines


def rows(seen: Seen) -> list[Row]:
    """What happened in one picture, as result.json has it."""
    table = [
        {"file": one.file, "colour": one.marked.colour, "marked": _circle(one.marked), "found": _found(one.ball)}
        for one in seen.outcomes
    ]
    false = [{"file": seen.path.name, "colour": colour, "marked": None, "found": _found(b)} for colour, b in seen.false]
    return table + false


def _circle(ball: MarkedBall | Ball) -> list[float]:
    return [round(value, 2) for value in (*ball.centre_px, ball.radius_px)]


def _found(ball: Ball | None) -> list[float] | None:
    """u, v, radius, its sigma, score."""
    return None if ball is None else [*_circle(ball), round(ball.radius_sigma_px, 2), round(ball.score, 3)]
