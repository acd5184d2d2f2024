"""A folder of a user's own pictures, and truth.csv, which says where in them the balls are.

One row a ball: `file`, `colour`, `u_px`, `v_px`, `radius_px`, and if wanted `tol_px`, by how much centre and radius may
be off as they were marked. Other columns are for people. A picture that truth.csv does not name holds no ball, and a
folder without truth.csv holds none at all.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, get_args

from agent.core.config import Colour, ConfigError
from hw.picture_files import picture_files

NAME = "truth.csv"
COLUMNS = ("file", "colour", "u_px", "v_px", "radius_px")
COLOURS: tuple[Colour, ...] = get_args(Colour)


class MarkedBall(NamedTuple):
    """A ball where somebody marked it. Pixels from the centre of the upper left pixel, u right, v down."""

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
