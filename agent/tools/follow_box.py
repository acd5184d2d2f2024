"""`aucamp track SOURCE --box X,Y,W,H`: follow what is in the box through a folder, a video or a camera's frames.

One line a frame on standard output; with --out also the pictures, with the box drawn in; with --truth how well the box
agrees with boxes that somebody has marked.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from agent.core.config import ConfigError
from agent.perception.tracking.box import Box
from agent.perception.tracking.box_trackers import load_box_tracker
from agent.perception.tracking.follow import FOLLOWED, Followed, Follower, parse_box
from agent.process.command import new_file, plain_console, run_folder, with_bar
from agent.tools.followed_pictures import Show, annotated, check_out, writer
from agent.tools.sources import Picture, Pictures, pictures
from agent.tools.track_truth import check_rows, first_box, read_truth, score, table, write_score

RATE_HZ = 30.0  # of pictures in a folder, where nobody says another
HEADER = "picture,t_s,x_px,y_px,width_px,height_px,score,state"


class Asked(NamedTuple):
    """The options of `aucamp track`."""

    box: str | None = None  # X,Y,W,H; None: the truth's first
    backbone: Path | None = None
    neck: Path | None = None
    frames: int | None = None
    out: Path | None = None
    truth: Path | None = None
    rate_hz: float | None = None
    result: Path | None = None


def run(source: str, asked: Asked, say: Callable[[str], None]) -> bool:
    """Say HEADER and a line for each picture; returns whether the thing is still there at the end, or with a truth
    that its figures are written.

    Raises ConfigError and CameraError, one line each, before anything is said or written where the first picture, the
    box and the truth do not go together.
    """
    truth = () if asked.truth is None else read_truth(asked.truth)
    if asked.box is None and not truth:
        raise ConfigError("track: say what to follow, with --box X,Y,W,H or with --truth FILE")
    drawn = first_box(truth) if asked.box is None else parse_box(asked.box)
    follower = Follower(load_box_tracker(asked.backbone, asked.neck))
    if asked.out is not None:
        check_out(asked.out)
    if asked.result is not None:
        new_file(asked.result)
    found = pictures(source, asked.frames)
    if found.kind == "images" and asked.frames is None:
        check_rows(truth, found.total or 0)
    first = next(found.each)  # there is one, or the walk has said why not
    follower.start(first.image, drawn)
    found = found._replace(each=itertools.chain((first,), found.each))
    console = plain_console(stderr=True)
    with writer(asked.out) as show:
        say(HEADER)
        said = with_bar(console, "following", lambda bar: follow(found, drawn, follower, show, say, bar))
    if not truth:
        return said[-1].state in FOLLOWED
    if asked.frames is None:
        check_rows(truth, len(said))
    figures = score([row for row in truth if row.frame < len(said)], said, asked.rate_hz or found.rate_hz or RATE_HZ)
    path = result_file(asked)
    write_score(figures, path)
    console.print(table(figures))
    console.print(f"written to {path}")
    return True


def follow(
    found: Pictures,
    box: Box,
    follower: Follower,
    show: Show,
    say: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> list[Followed]:
    """What is said of each picture. `follower` has been started on the first one, with this box."""
    size, said = None, [Followed(box, 1.0, "followed")]
    for k, picture in enumerate(found.each):
        if size is None:
            size = picture.image.shape
        elif picture.image.shape != size:
            raise ConfigError(f"{picture.name}: not of the size of the first picture; give pictures of one size")
        else:
            said.append(follower.look(picture.image))
        say(line(picture, said[-1]))
        show(annotated(picture.image, said[-1]), picture.name)
        progress(k + 1, found.total or k + 2)
    return said


def line(picture: Picture, now: Followed) -> str:
    t_s = "" if picture.t_s is None else f"{picture.t_s:.3f}"
    return f"{picture.name},{t_s},{','.join(f'{side:.1f}' for side in now.box)},{now.score:.2f},{now.state}"


def result_file(asked: Asked) -> Path:
    """Where the figures go: the file that was asked for, else result.json in the folder of the pictures, else in
    runs/<UTC>. Raises ConfigError."""
    if asked.result is not None:
        return asked.result
    folder = asked.out if asked.out is not None and asked.out.is_dir() else run_folder(None)
    return folder / "result.json"
