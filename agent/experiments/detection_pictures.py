"""How good is detection in a user's own water? Every picture of a folder is searched for balls of every colour.

Orange is what the rules of a known contest call its red buoy: red found where orange is marked, or the other way
round, is neither found nor false. Where neither is marked, what is found as both is one false ball.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple, get_args

import msgspec

from agent.core.config import Colour, ConfigError, read_file
from agent.core.picture_head import stated_size
from agent.core.ranging.camera_model import CameraFit
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value
from agent.perception.detection.detect import Ball, find_balls
from hw.camera.camera import Image
from hw.camera.files import MOST_BYTES, picture_files, read_picture

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
    size_of = cache(lambda name: stated_size(read_file(folder / name, MOST_BYTES)))
    if table.exists():
        for line, row in _rows(table):
            where, name = f"{table}: line {line}", row["file"]
            if name not in marked:
                raise ConfigError(f"{where}: no picture '{name}' beside it; correct the name")
            ball, size = _ball(row, where), size_of(name)
            if size is not None and not _shows(ball, size):
                text = f"nothing of the ball is in {name}, of {size[0]}x{size[1]} pixels"
                raise ConfigError(f"{where}: {text}; correct u_px, v_px or radius_px")
            marked[name].append(ball)
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


def _shows(ball: MarkedBall, size: tuple[int, int]) -> bool:
    """Whether some of it is in a picture of that width and height, pixels."""
    return all(-ball.radius_px < at < side - 1 + ball.radius_px for at, side in zip(ball.centre_px, size, strict=True))


def _number(text: str, where: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{where}: '{text}' is no number; write one in pixels")
    return value


# --- what is found in a picture ---

NEAR_ENOUGH = 0.2  # of the radius, in centre and in radius, as on the twin
HFOV_DEG = 10.0
ALIKE = frozenset({"red", "orange"})


class Outcome(NamedTuple):
    """One marked ball, and what was found of it."""

    marked: MarkedBall
    ball: Ball | None  # None: missed


class Seen(NamedTuple):
    """One picture: its marked balls with what was found of them, and what was called a ball beside."""

    outcomes: list[Outcome]
    false: list[tuple[Colour, Ball]]


def look(image: Image, marked: Sequence[MarkedBall]) -> Seen:
    """One picture, searched for each colour. What is false to two colours that are alike is false once."""
    camera = pinhole(image.shape[1], image.shape[0])
    outcomes: list[Outcome] = []
    false: list[tuple[Colour, Ball]] = []
    for colour in COLOURS:
        own = [ball for ball in marked if ball.colour == colour]
        balls = find_balls(image, camera, colour=colour)[: max(len(own), 1)]  # an agent takes the most convincing
        taken = matches(own, balls)
        outcomes += [Outcome(one, taken.get(k)) for k, one in enumerate(own)]
        excused = [ball for ball in marked if ball.colour == colour or {ball.colour, colour} <= ALIKE]
        known = [*excused, *(MarkedBall(c, b.centre_px, b.radius_px) for c, b in false if {c, colour} <= ALIKE)]
        false += [(colour, ball) for ball in balls if not any(distance(one, ball) <= 1.0 for one in known)]
    return Seen(outcomes, false)


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


# --- the claim ---
# A target: what the size cue needs, and about what a dive of 0.07 m balls shows within 10 m.

JUDGED_PX = 8.0  # balls from this radius on
SMALL_PX = 5.0  # smaller ones from this radius on


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    folder: str = ""  # of pictures, with a truth.csv


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A row for each picture. Raises ConfigError for what cannot be read."""
    if not settings.folder:
        raise ConfigError("experiment detection-pictures: no pictures; give their folder, --set folder=DIR")
    rows = []
    for path, marked in marked_pictures(Path(settings.folder)):
        seen = look(read_picture(path), marked)
        balls = [row_of(one) for one in seen.outcomes]
        rows.append({"file": path.name, "balls": balls, "false": [[colour, *_found(b)] for colour, b in seen.false]})
    return rows


def row_of(one: Outcome) -> Row:
    """A marked ball: what was found of it, how far its radius is off, and that in its stated sigma."""
    marked, ball = one
    row: Row = {"colour": marked.colour, "marked": _circle(marked), "found": None}
    if ball:
        off_px = abs(ball.radius_px - marked.radius_px)
        row["found"] = _found(ball)
        row["radius_percent"] = 100.0 * off_px / marked.radius_px
        row["sigmas"] = off_px / math.hypot(ball.radius_sigma_px, marked.tolerance_px)
    return row


def _circle(ball: MarkedBall | Ball) -> list[float]:
    return [round(value, 2) for value in (*ball.centre_px, ball.radius_px)]


def _found(ball: Ball) -> list[float]:
    """u, v, radius, its sigma, score."""
    return [*_circle(ball), round(ball.radius_sigma_px, 2), round(ball.score, 3)]


def summary(rows: Rows) -> dict[str, Value]:
    """Of the colours and sizes that are marked."""
    figures: dict[str, Value] = {"false": float(sum(len(row["false"]) for row in rows["all"]))}
    balls = [ball for row in rows["all"] for ball in row["balls"]]
    for colour in COLOURS:
        own = [ball for ball in balls if ball["colour"] == colour]
        large = [ball for ball in own if ball["marked"][2] >= JUDGED_PX]
        small = [ball for ball in own if SMALL_PX <= ball["marked"][2] < JUDGED_PX]
        for key, group in ((f"{colour}_found", large), (f"{colour}_small_found", small)):
            if group:
                figures[key] = Share(sum(ball["found"] is not None for ball in group), len(group))
        if any(ball["found"] for ball in large):
            off = [ball["radius_percent"] for ball in large if ball["found"]]
            figures[f"{colour}_radius_percent"] = Quantile(off, 50.0)
    sigmas = [ball["sigmas"] for ball in balls if ball["found"]]
    if sigmas:
        figures |= {f"within_{k}_sigma": Share(sum(one <= k for one in sigmas), len(sigmas)) for k in (1, 2, 3)}
    return figures


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    measured_on="real pictures",
    figures=(
        *(
            figure
            for colour in COLOURS
            for figure in (
                Figure(f"{colour}_found", f"{colour} balls of 8 px radius and more: found", "%", least=90.0),
                Figure(f"{colour}_radius_percent", f"{colour}: radius off, median", "%", most=5.0),
                Figure(f"{colour}_small_found", f"{colour} balls of 5 to 8 px radius: found", "%", least=60.0),
            )
        ),
        Figure("false", "called a ball, and none: in all pictures", "", most=0.0),
        *(Figure(f"within_{k}_sigma", f"radius within {k} of its stated sigma", "%") for k in (1, 2, 3)),
    ),
    exact=True,
    explanation="""Every picture of a folder is searched for balls of every colour. Found is what lies within a fifth of
        the marked radius, in centre and in radius; all else that is called a ball is false. Intervals say what so few
        balls leave open: 29 of a colour, all of them found, show that nine tenths are. The rows have every ball: marked
        are u, v and radius, found are u, v, radius, its sigma and the score.""",
)
