"""How well a followed box agrees with boxes that somebody has marked: `aucamp track SOURCE --truth FILE`."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from agent.kernel.config import ConfigError
from agent.perception.tracking.box import Box, overlap
from agent.perception.tracking.follow import FOLLOWED, State

ON_TARGET_IOU = 0.5  # from here on a box is on the thing, as in most tests of trackers
GRACE_S = 0.5  # within this time of its going it has to be said lost
COLUMNS = ("frame", "x", "y", "w", "h", "visible")


class Truth(NamedTuple):
    """What is in one frame."""

    frame: int
    box: Box | None  # None: it cannot be seen
    counted: bool = True  # False: only a sliver is seen, so that either answer is right


class Score(NamedTuple):
    """What `--truth` finds: numbers of frames, unless it says otherwise. Scored is every frame that is to be counted, the
    first included, whose box is given; of those in which the thing is away, the ones later than GRACE_S after it went."""

    frames: int
    on_target: int  # it is there, is said to be followed, and the boxes overlap by ON_TARGET_IOU
    mean_iou: float  # over all in which it is there; 0 where it is called lost
    absent: int
    absent_said_lost: int  # or ambiguous
    present_said_lost: int  # or ambiguous
    mean_iou_followed: float  # over those in which it is there and followed
    in_grace: int  # away for GRACE_S or less: not among `frames` and `absent`
    in_grace_said_lost: int


class Said(NamedTuple):
    """What a follower said of one frame."""

    box: Box
    state: State


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
    if not any(row.box for row in truth):
        raise ConfigError(f"{path}: the thing is visible in no frame; mark it in one at least")
    return sorted(truth)


def _row(path: Path, number: int, row: dict[str, str | None]) -> Truth:
    try:
        frame, visible, count = int(row["frame"] or ""), int(row["visible"] or ""), int(row.get("count") or 1)
        box = Box(*(float(row[side] or "") for side in "xywh")) if visible else None
        if frame < 0 or visible not in (0, 1) or (box and not (box.width > 0 and box.height > 0)):
            raise ValueError
    except ValueError:
        text = "frame, visible (0 or 1) and where it is visible x, y, w, h have to be numbers"
        raise ConfigError(f"{path}: line {number}: {text}") from None
    return Truth(frame, box, count != 0)


def score(truth: Iterable[Truth], said: Sequence[Said], rate_hz: float) -> Score:
    """truth: in the order of the frames. said: of each frame from 0 on."""
    overlaps: list[float] = []  # where it is there and followed
    present, late, early = [], [], []  # whether it was said to be followed
    went: int | None = None  # the frame in which it did
    for row in truth:
        went = None if row.box else row.frame if went is None else went
        if not row.counted:
            continue
        box, state = said[row.frame]
        followed = state in FOLLOWED
        if row.box:
            present.append(followed)
            overlaps += [overlap(box, row.box)] if followed else []
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
