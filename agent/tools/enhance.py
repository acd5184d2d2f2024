"""`aucamp enhance SOURCE`: an image, a folder of images, a video or a camera, written enhanced to another folder.

The output is always 8-bit colour, PNG for images and for the frames of a camera, MP4 for videos.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from rich.console import Console

from agent.core.config import ConfigError
from agent.perception.enhancement.enhance import BUDGET_MS, Enhancer, enhancer
from agent.perception.enhancement.grey_world import Image
from agent.perception.enhancement.variants import Variant
from agent.process.command import Progress, new_folder, with_bar
from agent.tools.sources import Pictures, pictures

FRAMES = 30  # of a camera, unless told


Render = Callable[[Image], Image]  # from a picture to what is written of it


def run(
    source: str,
    out: Path,
    side_by_side: bool,
    variant: Variant,
    weights: Path | None,
    frames: int | None,
    console: Console,
) -> int:
    """Exit code: 0, or 1 if a part of the source could not be read. Raises ConfigError and CameraError, one line."""
    new_folder(out)
    problems: list[str] = []
    found = pictures(source, frames, problems, of_camera=FRAMES)
    way = enhancer(variant, weights, BUDGET_MS if found.kind == "camera" else None)
    if way.why:
        console.print(f"{way.variant}: {way.why}")
    render = side_by_side_with(way) if side_by_side else way.apply
    make_folder(out)
    if found.kind == "video":
        with_bar(console, "enhance", lambda show: film(found, out / f"{Path(source).stem}.mp4", render, show))
    else:
        with_bar(console, "enhance", lambda show: stills(found, out, render, show))
    for problem in problems:
        console.print(f"skipped: {problem}" if found.kind == "images" else problem)
    console.print(f"written to {out}")
    return 1 if problems else 0


def side_by_side_with(way: Enhancer) -> Render:
    return lambda image: np.hstack([image, way.apply(image)])


def make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {out}: {error.strerror}; give a folder that can be written") from None


def stills(found: Pictures, out: Path, render: Render, show: Progress) -> None:
    """One PNG for each picture, with its name or number; two images of one stem keep their suffixes."""
    used: set[str] = set()
    for done, picture in enumerate(found.each, start=1):
        name = f"{Path(picture.name).stem}.png" if found.kind == "images" else f"{int(picture.name):06d}.png"
        name = f"{picture.name}.png" if name in used else name
        used.add(name)
        file = out / name
        if not cv2.imwrite(str(file), render(picture.image)):
            raise ConfigError(f"{file}: cannot be written; choose another folder with --out")
        show(done, found.total or done)
    if found.total:
        show(found.total, found.total)  # with those that were skipped


def film(found: Pictures, file: Path, render: Render, show: Progress) -> None:
    """One MP4 with the rate of the source."""
    rate_hz = found.rate_hz or 30.0
    first = next(found.each)  # there is one, or the walk has said why not
    result = render(first.image)
    size = (result.shape[1], result.shape[0])
    sink = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"mp4v"), rate_hz, size)
    if not sink.isOpened():
        raise ConfigError(f"{file}: cannot be written; choose another folder with --out")
    try:
        sink.write(result)
        for done, picture in enumerate(found.each, start=2):
            sink.write(render(picture.image))
            show(done, max(found.total or done, done))
    finally:
        sink.release()
