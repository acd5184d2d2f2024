"""How well a followed box agrees with boxes that somebody has marked: `aucamp track SOURCE --truth FILE`."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from rich.table import Table

from agent.core.config import ConfigError
from agent.perception.tracking.box import Box, overlap
from agent.perception.tracking.follow import FOLLOWED, Followed

ON_TARGET_IOU = 0.5  # from here on a box is on the thing, as in most tests of trackers
GRACE_S = 0.5  # within this time of its going it has to be said lost
COLUMNS = ("frame", "x", "y", "w", "h", "visible")


class Truth(NamedTuple):
    """What is in one frame."""

    frame: int
    box: Box | None  # None: it cannot be seen
    counted: bool = True  # False: only a sliver is seen, so that either answer is right


class Score(NamedTuple):
    """What `--truth` finds: numbers of frames, unless it says otherwise.

    Scored is every frame that is to be counted, the first included, whose box is given; of those in which the thing is
    away, the ones later than GRACE_S after it went.
    """

    frames: int
    on_target: int  # it is there, is said to be followed, and the boxes overlap by ON_TARGET_IOU
    mean_iou: float  # over all in which it is there; 0 where it is called lost
    absent: int
    absent_said_lost: int  # or ambiguous
    present_said_lost: int  # or ambiguous
    mean_iou_followed: float  # over those in which it is there and followed
    in_grace: int  # away for GRACE_S or less: not among `frames` and `absent`
    in_grace_said_lost: int


def read_truth(path: Path) -> list[Truth]:
    """The rows of a CSV with columns frame, x, y, w, h, visible, and count if it likes, in the order of the frames.

    Raises ConfigError, in one line, for a file that is not such a table.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as lines:
            table = csv.DictReader(lines)
            names = table.fieldnames or ()
            if missing := [name for name in COLUMNS if name not in names]:
                raise ConfigError(f"{path}: no column {', '.join(missing)}; it needs {','.join(COLUMNS)}")
            truth = [_row(path, number, row) for number, row in enumerate(table, start=2)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read as a table ({error}); give a CSV file") from None
    frames = [row.frame for row in truth]
    if len(set(frames)) != len(frames):
        raise ConfigError(f"{path}: a frame has two rows; leave one")
    if not truth:
        raise ConfigError(f"{path}: no rows; mark the thing in some frames")
    return sorted(truth, key=lambda row: row.frame)


def first_box(truth: Sequence[Truth]) -> Box:
    """Of frame 0. Raises ConfigError where none is marked there."""
    if truth[0].frame != 0 or truth[0].box is None:
        raise ConfigError("--truth: the thing is not marked in frame 0; mark it there, or draw it with --box X,Y,W,H")
    return truth[0].box


def check_rows(truth: Sequence[Truth], pictures: int) -> None:
    """Raises ConfigError for frames that the source has not."""
    if truth and truth[-1].frame >= pictures:
        text = f"--truth: frame {truth[-1].frame} is marked, but the source has {pictures} pictures, from 0 on"
        raise ConfigError(f"{text}; give the table that belongs to it")


def _row(path: Path, number: int, row: dict[str, str | None]) -> Truth:
    try:
        frame, visible, count = int(row["frame"] or ""), int(row["visible"] or ""), int(row.get("count") or 1)
        box = Box(*(float(row[side] or "") for side in "xywh")) if visible else None
        if frame < 0 or visible not in (0, 1) or (box and not (all(map(math.isfinite, box)) and min(box[2:]) > 0)):
            raise ValueError
    except ValueError:
        text = "frame, visible (0 or 1) and where it is visible x, y, w, h have to be numbers"
        raise ConfigError(f"{path}: line {number}: {text}") from None
    return Truth(frame, box, count != 0)


def score(truth: Iterable[Truth], said: Sequence[Followed], rate_hz: float) -> Score:
    """truth: in the order of the frames. said: of each frame from 0 on."""
    overlaps: list[float] = []  # where it is there and followed
    present, late, early = list[bool](), list[bool](), list[bool]()  # whether it was said to be followed
    went: int | None = None  # the frame in which it did
    for row in truth:
        went = None if row.box else row.frame if went is None else went
        if not row.counted:
            continue
        followed = said[row.frame].state in FOLLOWED
        if row.box:
            present.append(followed)
            overlaps += [overlap(said[row.frame].box, row.box)] if followed else []
        elif went is not None:
            (late if row.frame - went > GRACE_S * rate_hz else early).append(followed)
    return Score(
        frames=len(present) + len(late),
        on_target=sum(iou >= ON_TARGET_IOU for iou in overlaps),
        mean_iou=sum(overlaps) / max(len(present), 1),
        absent=len(late),
        absent_said_lost=late.count(False),
        present_said_lost=present.count(False),
        mean_iou_followed=sum(overlaps) / max(len(overlaps), 1),
        in_grace=len(early),
        in_grace_said_lost=early.count(False),
    )


def write_score(score: Score, path: Path) -> None:
    """As JSON. Raises ConfigError where that is not possible."""
    try:
        path.write_text(json.dumps(score._asdict(), indent=1) + "\n", encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}; give --result another place") from None


def table(score: Score) -> Table:
    """For people."""
    present = score.frames - score.absent
    shown = Table()
    for column in ("what", "frames", "of", "share"):
        shown.add_column(column, justify="left" if column == "what" else "right")
    for what, frames, of in (
        (f"there, and the boxes overlap by {ON_TARGET_IOU}", score.on_target, present),
        ("there, and called lost or ambiguous", score.present_said_lost, present),
        (f"away for more than {GRACE_S} s, and called so", score.absent_said_lost, score.absent),
        (f"away for up to {GRACE_S} s, and called so", score.in_grace_said_lost, score.in_grace),
    ):
        shown.add_row(what, str(frames), str(of), f"{frames / of:.1%}" if of else "-")
    text = (
        f"mean overlap while it is there {score.mean_iou:.2f}, while it is also followed {score.mean_iou_followed:.2f}"
    )
    shown.caption = text
    return shown
