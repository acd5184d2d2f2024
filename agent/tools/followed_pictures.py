"""Pictures with the box that was followed drawn in: a folder of them, or a video."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from agent.core.config import ConfigError
from agent.perception.tracking.follow import Followed, State
from agent.process.command import new_file, new_folder
from hw.camera.camera import Image

VIDEOS = {".mp4": "mp4v", ".avi": "MJPG"}  # suffix -> codec that every OpenCV writes
RATE_HZ = 30.0  # of the annotated video
GREEN, AMBER, RED = (60, 220, 60), (40, 170, 250), (60, 60, 230)
COLOURS: dict[State, tuple[int, int, int]] = {
    "followed": GREEN, "found again": GREEN, "ambiguous": AMBER, "lost": RED,
}  # fmt: skip

Show = Callable[[Image, str], None]  # a picture and its name


def annotated(image: Image, now: Followed) -> Image:
    """The picture with the box in it, where it is or was last seen, and what is said of it: green while it is followed,
    amber where it is ambiguous, red where it is lost."""
    drawn, colour, box = image.copy(), COLOURS[now.state], now.box
    left, top, right, bottom = map(round, (box.x, box.y, box.x + box.width, box.y + box.height))
    cv2.rectangle(drawn, (left, top), (right, bottom), colour, 2)
    text = f"{now.score:.2f}" if now.state == "followed" else now.state
    cv2.putText(drawn, text, (left, max(top - 6, 14)), cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, 1)
    return drawn


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
