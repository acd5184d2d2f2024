"""A source of pictures by name: a folder of photographs, a video file, or the address of a camera."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from agent.config import ConfigError
from hw.camera import CameraGone, Image, open_camera

SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff")


class Picture(NamedTuple):
    name: str  # of the file; of a video or a camera the number of the frame, from 0
    t_s: float | None  # from the first picture on; None in a folder
    image: Image  # (height, width, 3), blue green red


class Pictures(NamedTuple):
    """Walk through `each` once; a camera is open until the walk ends."""

    each: Iterator[Picture]
    total: int | None  # None where only the end of the source tells


def pictures(source: str, frames: int | None) -> Pictures:
    """`frames` ends the walk early; a camera needs it. Raises ConfigError, and CameraError as the camera does."""
    place = Path(source)
    if place.is_dir():
        paths = sorted(path for path in place.iterdir() if path.suffix.lower() in SUFFIXES)[:frames]
        if not paths:
            raise ConfigError(f"{source}: no pictures in it; give a folder with {', '.join(SUFFIXES)} files")
        return Pictures(_photographs(paths), len(paths))
    if place.is_file():
        return Pictures(_shots(f"video:{source}", frames), frames)
    if ":" not in source:
        raise ConfigError(f"{source}: no such file or folder; give one, or the address of a camera (v4l2:/dev/video0)")
    if frames is None and not source.startswith("video:"):
        raise ConfigError(f"{source}: a camera never ends; say how many frames with --frames")
    return Pictures(_shots(source, frames), frames)


def _photographs(paths: list[Path]) -> Iterator[Picture]:
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise ConfigError(f"{path}: not a picture that OpenCV can read; remove or replace it")
        yield Picture(path.name, None, np.asarray(image, np.uint8))


def _shots(url: str, frames: int | None) -> Iterator[Picture]:
    camera, first_ns, number = open_camera(url, Path(), None), None, 0
    try:
        while frames is None or number < frames:
            try:
                frame = camera.read()
            except CameraGone:
                if url.startswith("video:") and number:
                    return  # its end
                raise
            first_ns = frame.t_ns if first_ns is None else first_ns
            yield Picture(str(number), (frame.t_ns - first_ns) * 1e-9, frame.image)
            number += 1
    finally:
        camera.close()
