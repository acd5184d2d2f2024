"""`aucamp track SOURCE --box X,Y,W,H`: follow what is in the box through a folder, a video or a camera's frames.

One line a frame on standard output; with --out also the pictures, with the box drawn in.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from agent.kernel.config import ConfigError
from agent.perception.detection.detectors import BoxDetector, Found, boxed
from agent.perception.tracking.box import Box
from agent.perception.tracking.box_trackers import load_box_tracker
from agent.perception.tracking.follow import Follower, parse_box
from agent.pictures.sources import Picture, Pictures, pictures
from agent.plain_console import plain_console
from agent.progress import with_bar
from agent.run_folder import new_file, new_folder
from hw.camera.camera import Image

VIDEOS = {".mp4": "mp4v", ".avi": "MJPG"}  # suffix -> codec that every OpenCV writes
RATE_HZ = 30.0  # of the annotated video
HEADER = "picture,t_s,x_px,y_px,width_px,height_px,score,lost"
GREEN, RED = (60, 220, 60), (60, 60, 230)

Show = Callable[[Image, str], None]  # a picture and its name


def run(
    source: str,
    box: str,
    backbone: Path | None,
    neck: Path | None,
    frames: int | None,
    out: Path | None,
    say: Callable[[str], None],
) -> bool:
    """Say HEADER and a line for each picture; returns whether the thing is still there at the end.

    Raises ConfigError and CameraError, one line each, before anything is said or written where the first picture and
    the box do not go together.
    """
    drawn, follower = parse_box(box), Follower(load_box_tracker(backbone, neck))
    if out is not None:
        check_out(out)
    found = pictures(source, frames)
    first = next(found.each)  # there is one, or the walk has said why not
    follower.start(first.image, drawn)
    found = found._replace(each=itertools.chain((first,), found.each))
    console = plain_console(stderr=True)
    with writer(out) as show:
        say(HEADER)
        return with_bar(console, "following", lambda bar: follow(found, drawn, follower, show, say, bar))


def follow(
    found: Pictures,
    box: Box,
    follower: Follower,
    show: Show,
    say: Callable[[str], None],
    progress: Callable[[int, int], None],
) -> bool:
    """`follower` has been started on the first picture."""
    detector, size = BoxDetector(follower), None
    now: Found | None = boxed(box, 1.0)
    for k, picture in enumerate(found.each):
        if size is None:
            size = picture.image.shape
        elif picture.image.shape != size:
            raise ConfigError(f"{picture.name}: not of the size of the first picture; give pictures of one size")
        else:
            now = detector.find(picture.image)
        box = now.box if now else box
        say(line(picture, now, box))
        show(annotated(picture.image, now, box), picture.name)
        progress(k + 1, found.total or k + 2)
    return now is not None


def line(picture: Picture, now: Found | None, last: Box) -> str:
    t_s = "" if picture.t_s is None else f"{picture.t_s:.3f}"
    score = now.score if now else 0.0
    return f"{picture.name},{t_s},{','.join(f'{side:.1f}' for side in last)},{score:.2f},{int(now is None)}"


def annotated(image: Image, now: Found | None, last: Box) -> Image:
    """The picture with the box in it: green while it is followed, red where it was lost."""
    drawn, colour = image.copy(), GREEN if now else RED
    corners = [(round(x), round(y)) for x, y in ((last.x, last.y), _far_corner(last))]
    cv2.rectangle(drawn, corners[0], corners[1], colour, 2)
    text = f"{now.score:.2f}" if now else "lost"
    cv2.putText(drawn, text, (corners[0][0], max(corners[0][1] - 6, 14)), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1)
    return drawn


def _far_corner(box: Box) -> tuple[float, float]:
    return box.x + box.width, box.y + box.height


def check_out(out: Path) -> None:
    """Raises ConfigError for what is no new video and no new folder."""
    if out.suffix.lower() in VIDEOS:
        new_file(out)
    elif out.suffix and not out.is_dir():
        raise ConfigError(f"{out}: give --out a folder, or a video that ends in {' or '.join(VIDEOS)}")
    else:
        new_folder(out)


@contextmanager
def writer(out: Path | None) -> Iterator[Show]:
    """Where annotated pictures go: a video if `out` ends as one, else a folder. Raises ConfigError."""
    if out is None:
        yield lambda image, name: None
    elif out.suffix.lower() in VIDEOS:
        film: list[cv2.VideoWriter] = []

        def add(image: Image, name: str) -> None:
            if not film:
                codec = cv2.VideoWriter.fourcc(*VIDEOS[out.suffix.lower()])
                film.append(cv2.VideoWriter(str(out), codec, RATE_HZ, (image.shape[1], image.shape[0])))
                if not film[0].isOpened():
                    raise ConfigError(f"{out}: cannot be written; choose another place or give a folder")
            film[0].write(np.ascontiguousarray(image))

        try:
            yield add
        finally:
            for one in film:
                one.release()
    else:
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"{out}: cannot be made: {error.strerror}; choose another place") from None
        yield lambda image, name: _save(out, image, name)


def _save(folder: Path, image: Image, name: str) -> None:
    stem = Path(name).stem
    path = folder / f"{stem.zfill(6) if stem.isdigit() else stem}.png"
    if not cv2.imwrite(str(path), image):
        raise ConfigError(f"{path}: cannot be written; choose another folder")
