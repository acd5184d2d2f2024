"""How good is detection in a user's own water? Every picture of a folder is searched for balls of every colour.

Found is what lies, in centre and in radius, within a fifth of the radius of a marked ball of the colour, and besides
within the marking's own tolerance; everything else that is called a ball is false. Orange is what the rules of a known
contest call its red buoy: red found where orange is marked, or the other way round, is neither found nor false.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, get_args

import cv2
import numpy as np
from matplotlib.figure import Figure
from msgspec import Struct
from numpy.typing import NDArray
from rich.console import Group
from rich.table import Table

from agent.core.config import Colour, ConfigError
from agent.core.ranging.camera_model import CameraFit
from agent.experiments.experiment import ExperimentResult, Figures, Row
from agent.perception.detection.detect import Ball, find_balls
from agent.process.command import Progress, step_by_step
from hw.camera.camera import Image
from hw.camera.files import picture_files, read_picture

# --- a folder of pictures and its truth.csv ---
# truth.csv says where in the pictures the balls are. One row a ball: `file`, `colour`, `u_px`, `v_px`, `radius_px`, and
# if wanted `tol_px`, by how much centre and radius may be off as they were marked. Other columns are for people. A
# picture that truth.csv does not name holds no ball, and a folder without truth.csv holds none at all.

NAME = "truth.csv"
COLUMNS = ("file", "colour", "u_px", "v_px", "radius_px")
COLOURS: tuple[Colour, ...] = get_args(Colour)


class MarkedBall(NamedTuple):
    """A ball as a person marked it. Pixels from the centre of the upper left pixel, u right, v down."""

    colour: Colour
    centre_px: tuple[float, float]
    radius_px: float
    tolerance_px: float = 0.0  # of centre and radius, as marked


def marked_pictures(folder: Path) -> list[tuple[Path, list[MarkedBall]]]:
    """Every picture of the folder with its balls, in the order of their names.

    Raises ConfigError if there are no pictures, and for a truth.csv that cannot be meant.
    """
    pictures = picture_files(folder)
    marked: dict[str, list[MarkedBall]] = {path.name: [] for path in pictures}
    table = folder / NAME
    if table.exists():
        for line, row in _rows(table):
            if row["file"] not in marked:
                raise ConfigError(f"{table}: line {line}: no picture '{row['file']}' beside it; correct the name")
            marked[row["file"]].append(_ball(row, f"{table}: line {line}"))
    return [(path, marked[path.name]) for path in pictures]


def _rows(table: Path) -> Sequence[tuple[int, Mapping[str, str]]]:
    """Line number and fields of each row."""
    try:
        reader = csv.DictReader(table.read_text(encoding="utf-8-sig").splitlines(), skipinitialspace=True)
        names = reader.fieldnames or ()
        rows = [(reader.line_num, {name: value or "" for name, value in row.items() if name}) for row in reader]
    except OSError as error:
        raise ConfigError(f"{table}: cannot be read ({error.strerror}); make it a readable file") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{table}: not a table in UTF-8 ({error}); write one with commas") from None
    for name in COLUMNS:
        if name not in names:
            raise ConfigError(f"{table}: no column `{name}`; the first line has to name {', '.join(COLUMNS)}")
    return rows


def _ball(row: Mapping[str, str], where: str) -> MarkedBall:
    """One row; `where` begins the complaint."""
    colour = next((known for known in COLOURS if known == row["colour"]), None)
    if colour is None:
        raise ConfigError(f"{where}: colour '{row['colour']}' is not known; write {', '.join(COLOURS)}")
    numbers = {name: _number(row[name], f"{where}: {name}") for name in COLUMNS[2:]}
    if not numbers["radius_px"] > 0.0:
        raise ConfigError(f"{where}: radius_px is {row['radius_px']}; a ball has a radius above 0")
    tolerance_px = _number(row["tol_px"], f"{where}: tol_px") if row.get("tol_px") else 0.0
    if tolerance_px < 0.0:
        raise ConfigError(f"{where}: tol_px is {row['tol_px']}; write 0 or more, or leave it empty")
    return MarkedBall(colour, (numbers["u_px"], numbers["v_px"]), numbers["radius_px"], tolerance_px)


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{where}: '{text}' is no number; write one in pixels")
    return value


# --- the experiment ---

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
    """A camera for a bare picture without a calibration."""
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


# --- table ---


def table(result: Result) -> Group:
    """A line for each colour and stretch of radius, what was false, and which targets are missed."""
    shown = Table(title=f"{result.folder}: {result.pictures} pictures, each searched for every colour")
    for column in ("ball", "radius px", "found", "radius error, median"):
        shown.add_column(column, justify="left" if column == "ball" else "right")
    for row in result.by_radius:
        shown.add_row(row["colour"], _stretch(row), f"{row['found']}/{row['marked']}", _percent(row))
    lines = [f"called a ball and none: {result.false} in {result.pictures} pictures"]
    if result.within_sigma is not None:
        shares = " / ".join(f"{100 * share:.0f} %" for share in result.within_sigma)
        lines.append(f"radius within 1 / 2 / 3 of its stated sigma: {shares}")
    lines += [f"missed: {text}" for text in result.missed] or [f"targets kept: {_kept(result)}"]
    return Group(shown, *lines)


def _kept(result: Result) -> str:
    """What a folder has shown: of balls nothing where none is marked that large."""
    if not any(row["radius_px"][0] >= JUDGED_PX for row in result.by_radius):
        return f"none false; no ball from {JUDGED_PX:g} px radius on is marked, so nothing is said of found ones"
    found, radius = f"found {100 * FOUND_SHARE:.0f} %", f"radius within {100 * RADIUS_ERROR:.0f} %"
    return f"{found} from {JUDGED_PX:g} px on, {radius}, none false"


def _stretch(row: Row) -> str:
    low, high = row["radius_px"]
    return f"{low:g} and more" if high is None else f"{low:g} to {high:g}"


def _percent(row: Row) -> str:
    return "-" if row["radius_error_median"] is None else f"{100 * row['radius_error_median']:.1f} %"


# --- figures ---
# Pictures with circles: white where a marked ball was found, red where one was missed, yellow where there is none.

SHEET_COLUMNS, ROWS = 4, 4  # of a sheet
TILE_PX = (400, 300)  # width, height
FOUND, MISSED, FALSE = (255, 255, 255), (0, 0, 255), (0, 255, 255)  # blue green red


def figures(result: Result) -> Figures:
    """Sheets of all pictures with something to show: a marked ball, or one where there is none."""
    worth = [seen for seen in result.shown if seen.outcomes or seen.false]
    for number, start in enumerate(range(0, len(worth), SHEET_COLUMNS * ROWS), start=1):
        yield f"sheet_{number:03d}.png", _sheet(worth[start : start + SHEET_COLUMNS * ROWS])


def _sheet(pictures: Sequence[Seen]) -> Figure:
    width, height = TILE_PX
    canvas = np.zeros((height * -(-len(pictures) // SHEET_COLUMNS), width * SHEET_COLUMNS, 3), np.uint8)
    for k, seen in enumerate(pictures):
        top, left = height * (k // SHEET_COLUMNS), width * (k % SHEET_COLUMNS)
        tile = _tile(seen)
        canvas[top : top + tile.shape[0], left : left + tile.shape[1]] = tile
    figure = Figure(figsize=(canvas.shape[1] / 100, canvas.shape[0] / 100), dpi=100)
    figure.figimage(canvas[..., ::-1])
    return figure


def _tile(seen: Seen) -> NDArray[np.uint8]:
    """One picture, made to fit, with its circles and its name."""
    image = read_picture(seen.path)
    scale = min(TILE_PX[0] / image.shape[1], TILE_PX[1] / image.shape[0])
    tile = np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)
    circles = [(one.ball or one.marked, FOUND if one.ball else MISSED) for one in seen.outcomes]
    for ball, colour in circles + [(ball, FALSE) for _, ball in seen.false]:
        u, v = (round(scale * at) for at in ball.centre_px)
        cv2.circle(tile, (u, v), max(round(scale * ball.radius_px) + 2, 3), colour, 1, cv2.LINE_AA)
    cv2.putText(tile, seen.path.name, (4, 12), cv2.FONT_HERSHEY_SIMPLEX, 0.4, FOUND, 1, cv2.LINE_AA)
    return tile
