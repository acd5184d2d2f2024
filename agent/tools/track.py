"""`aucamp track SOURCE --box X,Y,W,H`: follow what is in the box through a folder, a video or a camera's frames; draw
it, and compare it with boxes that a person has marked.

One line a frame on standard output; with --out also the pictures, with the box drawn in; with --truth how well the box
agrees with boxes that somebody has marked.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import cv2
from rich.table import Table

from agent.core.config import ConfigError, write_whole
from agent.perception.tracking.appearance import Box, overlap
from agent.perception.tracking.follow import (
    FOLLOWED,
    LIMITS,
    Followed,
    Follower,
    Limits,
    State,
    load_box_tracker,
    parse_box,
)
from agent.process.command import new_file, new_folder, plain_console, run_folder, with_bar
from agent.tools.enhance import Picture, Pictures, first_of, own_name, pictures
from hw.camera.camera import Image
from hw.camera.files import read_rows, write_picture
from replay.files.frames import CODECS, film

# --- pictures with the box ---
# Pictures with the box that was followed drawn in: a folder of them, or a video.

RATE_HZ = 30.0  # of pictures of which nobody says it
GREEN, AMBER, RED = (60, 220, 60), (40, 170, 250), (60, 60, 230)
COLOURS: dict[State, tuple[int, int, int]] = {
    "followed": GREEN, "found again": GREEN, "ambiguous": AMBER, "lost": RED,
}  # fmt: skip

Show = Callable[[Image, str], None]  # a picture and its name


def annotated(image: Image, now: Followed) -> Image:
    """The picture with the box in it, green, and its score. Where it is ambiguous, amber, or lost, red, a circle in
    which its middle may be by now."""
    drawn, colour, box = image.copy(), COLOURS[now.state], now.box
    left, top, right, bottom = map(round, (box.x, box.y, box.x + box.width, box.y + box.height))
    if now.lost:
        u, v = box.centre_px
        cv2.circle(drawn, (round(u), round(v)), round(now.reach_px), colour, 1, cv2.LINE_AA)
    else:
        cv2.rectangle(drawn, (left, top), (right, bottom), colour, 2)
    text = f"{now.score:.2f}" if now.state == "followed" else now.state
    cv2.putText(drawn, text, (left, max(top - 6, 14)), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1)
    return drawn


def check_out(out: Path) -> None:
    """Raises ConfigError for what is no new video and no new folder."""
    if out.suffix.lower() in CODECS:
        new_file(out)
    elif out.suffix and not out.is_dir():
        raise ConfigError(f"{out}: give --out a folder, or a video that ends in {' or '.join(CODECS)}")
    else:
        new_folder(out)


@contextmanager
def writer(out: Path | None, rate_hz: float | None = None) -> Iterator[Show]:
    """Where annotated pictures go: a video if `out` ends as one, else a folder. rate_hz: of the pictures, where
    it is known. Raises ConfigError."""
    if out is None:
        yield lambda image, name: None
    elif out.suffix.lower() in CODECS:
        with film(out, rate_hz or RATE_HZ) as made:
            yield lambda image, name: made.add(image)
    else:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{out}: cannot be made: {error.strerror}; choose another place") from None
        used: set[str] = set()
        yield lambda image, name: _save(out, image, name, used)


def _save(folder: Path, image: Image, name: str, used: set[str]) -> None:
    stem = Path(name).stem
    write_picture(folder / own_name(stem.zfill(6) if stem.isdigit() else stem, name, used), image)


# --- against marked boxes ---
# How well a followed box agrees with boxes that somebody has marked: `aucamp track SOURCE --truth FILE`.

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
    names, table = read_rows(path)
    if missing := [name for name in COLUMNS if name not in names]:
        raise ConfigError(f"{path}: no column {', '.join(missing)}; it needs {','.join(COLUMNS)}")
    truth = [_row(path, number, row) for number, row in table]
    frames = [row.frame for row in truth]
    if len(set(frames)) != len(frames):
        raise ConfigError(f"{path}: a frame has two rows; leave one")
    if not truth:
        raise ConfigError(f"{path}: no rows; mark the thing in some frames")
    return sorted(truth, key=lambda row: row.frame)


def first_box(truth: Sequence[Truth], place: int) -> Box:
    """Of the frame at this place, the first that can be read. Raises ConfigError where none is marked there."""
    box = next((row.box for row in truth if row.frame == place), None)
    if box is None:
        what = f"--truth: the thing is not marked in frame {place}{', the first that can be read' if place else ''}"
        raise ConfigError(f"{what}; mark it there, or draw it with --box X,Y,W,H")
    return box


def check_rows(truth: Sequence[Truth], pictures: int) -> None:
    """Raises ConfigError for frames that the source has not."""
    if truth and truth[-1].frame >= pictures:
        text = f"--truth: frame {truth[-1].frame} is marked, but the source has {pictures} pictures, from 0 on"
        raise ConfigError(f"{text}; give the table that belongs to it")


def _row(path: Path, number: int, row: dict[str, str]) -> Truth:
    try:
        frame, visible, count = int(row["frame"] or ""), int(row["visible"] or ""), int(row.get("count") or 1)
        box = Box(*(float(row[side] or "") for side in "xywh")) if visible else None
        if frame < 0 or visible not in (0, 1) or (box and not (all(map(math.isfinite, box)) and min(box[2:]) > 0)):
            raise ValueError
    except ValueError:
        text = "frame, visible (0 or 1) and where it is visible x, y, w, h have to be numbers"
        raise ConfigError(f"{path}: line {number}: {text}") from None
    return Truth(frame, box, count != 0)


def score(truth: Iterable[Truth], said: Mapping[int, Followed], rate_hz: float) -> Score:
    """truth: in the order of the frames. said: of each frame that could be read; others are not scored."""
    overlaps: list[float] = []  # where it is there and followed
    present, late, early = list[bool](), list[bool](), list[bool]()  # whether it was said to be followed
    went: int | None = None  # the frame in which it did
    for row in truth:
        went = None if row.box else row.frame if went is None else went
        if not row.counted or row.frame not in said:
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
    """As JSON. Raises OSError where that is not possible."""
    write_whole(path, json.dumps(score._asdict(), indent=1) + "\n")


def table(scores: Mapping[str, Score]) -> Table:
    """For people: a column for each of LIMITS."""
    shown = Table()
    for column in ("what", "frames", *(f"--{name}" for name in scores)):
        shown.add_column(column, justify="left" if column == "what" else "right")
    any_score = next(iter(scores.values()))
    present = any_score.frames - any_score.absent
    for what, of, counted in (
        (f"there, and the boxes overlap by {ON_TARGET_IOU}", present, "on_target"),
        ("there, and called lost or ambiguous", present, "present_said_lost"),
        (f"away for more than {GRACE_S} s, and called so", any_score.absent, "absent_said_lost"),
        (f"away for up to {GRACE_S} s, and called so", any_score.in_grace, "in_grace_said_lost"),
    ):
        shares = (f"{getattr(score, counted) / of:.1%}" if of else "-" for score in scores.values())
        shown.add_row(what, str(of), *shares)
    overlaps = (f"{score.mean_iou_followed:.2f}" for score in scores.values())
    shown.add_row("mean overlap where it is there and followed", "", *overlaps)
    return shown


# --- following ---

HEADER = "picture,t_s,x_px,y_px,width_px,height_px,score,state"


class Asked(NamedTuple):
    """The options of `aucamp track`."""

    box: str | None = None  # X,Y,W,H; None: the truth's first
    nanotrack: tuple[Path, Path] | None = None  # backbone and neck; None: a correlation filter
    frames: int | None = None
    out: Path | None = None
    truth: Path | None = None
    rate_hz: float | None = None
    keep: bool = False  # by the limits KEEP


def run(source: str, asked: Asked, say: Callable[[str], None]) -> bool:
    """Say HEADER and a line for each picture; returns whether every picture could be read and the thing is still there
    at the end, or with a truth that its figures are written.

    Raises ConfigError and CameraError, one line each, before anything is said or written where the first picture, the
    box and the truth do not go together.
    """
    truth = () if asked.truth is None else read_truth(asked.truth)
    if asked.box is None and not truth:
        raise ConfigError("track: say what to follow, with --box X,Y,W,H or with --truth FILE")
    drawn = None if asked.box is None else parse_box(asked.box)
    name = "keep" if asked.keep else "strict"
    follower = Follower(load_box_tracker(asked.nanotrack), LIMITS[name])
    if asked.out is not None:
        check_out(asked.out)
    first, found = first_of(pictures(source, asked.frames))
    drawn = first_box(truth, first.place) if drawn is None else drawn
    if found.total is not None and asked.frames is None:
        check_rows(truth, found.total)
    follower.start(first.image, drawn)
    console = plain_console(stderr=True)
    with writer(asked.out, asked.rate_hz or found.rate_hz) as show:
        say(HEADER)
        said = with_bar(console, "following", lambda bar: follow(found, drawn, follower, show, say, bar))
    for text in (*found.notes, *found.problems):
        console.print(text, highlight=False)
    last = max(said)
    if not truth:
        return said[last].state in FOLLOWED and not found.problems
    if asked.frames is None and found.total is None:
        check_rows(truth, last + 1)
    rate_hz = asked.rate_hz or found.rate_hz or RATE_HZ
    counted = [row for row in truth if row.frame < (asked.frames or math.inf)]
    unread = sum(row.frame not in said for row in counted)
    if unread:
        console.print(f"--truth: {unread} of {len(counted)} marked frames could not be read and are not scored")
    scores = {name: score(counted, said, rate_hz)}
    path = result_file(asked)
    write_score(scores[name], path)
    if found.kind != "camera":  # whose pictures do not come again
        other = next(each for each in LIMITS if each != name)
        scores[other] = score(counted, _again(source, asked, drawn, LIMITS[other]), rate_hz)
    console.print(table(scores))
    console.print(f"written to {path}: {name}")
    return not found.problems


def _again(source: str, asked: Asked, box: Box, limits: Limits) -> dict[int, Followed]:
    """The same pictures by other limits."""
    follower, each = Follower(load_box_tracker(asked.nanotrack), limits), pictures(source, asked.frames).each
    first = next(each)
    follower.start(first.image, box)
    return {first.place: Followed(box, 1.0, "followed")} | {one.place: follower.look(one.image) for one in each}


def follow(
    found: Pictures,
    box: Box,
    follower: Follower,
    show: Show,
    say: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> dict[int, Followed]:
    """What is said of each picture, by its place. `follower` has been started on the first one, with this box."""
    size, said = None, dict[int, Followed]()
    for k, picture in enumerate(found.each):
        if size is None:
            size, now = picture.image.shape, Followed(box, 1.0, "followed")
        elif picture.image.shape != size:
            raise ConfigError(f"{picture.name}: not of the size of the first picture; give pictures of one size")
        else:
            now = follower.look(picture.image)
        said[picture.place] = now
        say(line(picture, now))
        show(annotated(picture.image, now), picture.name)
        progress(k + 1, found.total or k + 2)
    return said


def line(picture: Picture, now: Followed) -> str:
    t_s = "" if picture.t_s is None else f"{picture.t_s:.3f}"
    return f"{picture.name},{t_s},{','.join(f'{side:.1f}' for side in now.box)},{now.score:.2f},{now.state}"


def result_file(asked: Asked) -> Path:
    """Where the figures go: result.json in the folder of the pictures, else in runs/<UTC>. Raises ConfigError."""
    folder = asked.out if asked.out is not None and asked.out.is_dir() else run_folder(None)
    return folder / "result.json"
