"""A source of pictures by name: an image, a folder of images, a video file, or the address of a camera."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Literal, NamedTuple

import cv2

from agent.core.config import ConfigError
from hw.camera.camera import CameraGone, Image
from hw.camera.open import open_camera
from hw.picture_files import SUFFIXES, picture_files, read_picture

READ_TIMEOUT_S = 2.0  # a camera that has just been opened takes longer than one that runs
WHOLE = 0.98  # of the frames that a video announces: files without an index state an estimate


class Picture(NamedTuple):
    name: str  # of the file; of a video or a camera the number of the frame, from 0
    t_s: float | None  # from the first picture on; None for images
    image: Image  # (height, width, 3), blue green red


class Pictures(NamedTuple):
    """Walk through `each` once; a camera is open until the walk ends."""

    kind: Literal["images", "video", "camera"]
    each: Iterator[Picture]
    total: int | None  # None where only the end of the source tells
    rate_hz: float | None = None  # of a video


def pictures(
    source: str, frames: int | None, problems: list[str] | None = None, of_camera: int | None = None
) -> Pictures:
    """`frames` ends the walk early. A camera never ends: it needs `frames`, or `of_camera` in its place.

    Where `problems` is given, an image of a folder that cannot be read is named in it and passed over, and so is a
    video that ends before its time; else the walk raises. Raises ConfigError, and CameraError as the camera does.
    """
    place = Path(source)
    if place.is_dir():
        paths = picture_files(place)[:frames]
        return Pictures("images", _images(paths, problems), len(paths))
    if place.suffix.lower() in SUFFIXES and place.is_file():
        return Pictures("images", _images([place], None), 1)
    if place.is_file():
        rate_hz, count = _announced(place)
        return Pictures("video", _film(place, frames, count, problems), min(frames or count, count) or None, rate_hz)
    if ":" not in source:
        raise ConfigError(f"{source}: no such file or folder; give one, or the address of a camera (v4l2:/dev/video0)")
    most = frames or of_camera
    if most is None and not source.startswith("video:"):
        raise ConfigError(f"{source}: a camera never ends; say how many frames with --frames")
    return Pictures("camera", _shots(source, most), most)


def _images(paths: list[Path], problems: list[str] | None) -> Iterator[Picture]:
    for path in paths:
        try:
            image = read_picture(path, stretch=True)  # each is looked at by itself
        except ConfigError as error:
            if problems is None:
                raise
            problems.append(str(error))
        else:
            yield Picture(path.name, None, image)


def _announced(path: Path) -> tuple[float, int]:
    """Frames per second and number of frames, as the file says; 30 and 0 where it does not."""
    capture = cv2.VideoCapture(str(path))
    rate_hz, count = capture.get(cv2.CAP_PROP_FPS), int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    capture.release()
    return rate_hz if rate_hz > 0 else 30.0, max(count, 0)


def _film(path: Path, frames: int | None, count: int, problems: list[str] | None) -> Iterator[Picture]:
    number = 0
    for picture in _shots(f"video:{path}", frames):
        yield picture
        number += 1
    if number < WHOLE * min(frames or count, count) and problems is not None:
        problems.append(f"{path}: ends after {number} of {count} frames; it was cut off, copy or convert it again")


def _shots(url: str, frames: int | None) -> Iterator[Picture]:
    first_ns, number = None, 0
    with closing(open_camera(url, Path(), None)) as camera:
        while frames is None or number < frames:
            try:
                frame = camera.read(timeout_s=READ_TIMEOUT_S)
            except CameraGone:
                if not url.startswith("video:"):
                    raise
                if number:
                    return  # its end
                raise ConfigError(f"{url}: not one frame can be read; convert it to H.264 in MP4") from None
            first_ns = frame.t_ns if first_ns is None else first_ns
            yield Picture(str(number), (frame.t_ns - first_ns) * 1e-9, frame.image)
            number += 1
