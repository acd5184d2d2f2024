"""`aucamp enhance SOURCE`: an image, a folder of images, a video or a camera, written enhanced to another folder.

16-bit images are scaled to 8 bits by their own largest value, grey ones become three equal colours, an alpha plane is
left out; the output is always 8-bit colour, PNG for images, MP4 for videos.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from rich.console import Console

from agent.config import ConfigError
from agent.launch import with_bar
from agent.perception.enhance import Enhancer, Variant, enhancer
from agent.perception.grey_world import Image
from hw.camera import SCHEMES, CameraGone, open_camera

IMAGES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
VIDEOS = (".mp4", ".avi", ".mkv", ".mov", ".webm", ".m4v")
FRAMES = 30  # of a camera, unless told
READ_TIMEOUT_S = 2.0


class Options(NamedTuple):
    out: Path
    side_by_side: bool
    frames: int | None


def run(
    source: str,
    out: Path,
    side_by_side: bool,
    variant: Variant,
    weights: Path | None,
    frames: int | None,
    console: Console,
) -> int:
    """Exit code: 0, or 1 if a picture could not be read. Raises ConfigError and CameraError, each one line."""
    options = Options(out, side_by_side, frames)
    work: Callable[[Enhancer, Callable[[int, int], None]], list[str]]
    place = Path(source)
    if source.partition(":")[0] in SCHEMES and not place.exists():
        count = frames or FRAMES
        work = lambda way, show: camera(source, count, way, options, show)  # noqa: E731
    elif place.suffix.lower() in VIDEOS and place.is_file():
        work = lambda way, show: video(place, way, options, show)  # noqa: E731
    else:
        files = pictures(place)
        work = lambda way, show: images(files, way, options, show)  # noqa: E731
    way = enhancer(variant, weights)
    if way.why:
        console.print(f"{way.variant}: {way.why}")
    folder(out, place)
    problems = with_bar(console, "enhance", lambda show: work(way, show))
    for problem in problems:
        console.print(f"skipped: {problem}")
    console.print(f"written to {out}")
    return 1 if problems else 0


def pictures(place: Path) -> list[Path]:
    """The images that a path means, in order of their names."""
    if place.is_dir():
        files = sorted(file for file in place.iterdir() if file.suffix.lower() in IMAGES)
        if not files:
            raise ConfigError(f"{place}: no images in this folder; it needs files that end in {' '.join(IMAGES)}")
        return files
    if not place.is_file():
        raise ConfigError(
            f"{place}: no such file; give an image, a folder, a video or a camera such as v4l2:/dev/video0"
        )
    return [place]


def read(path: Path) -> Image:
    """An image file as 8-bit blue green red. Raises ConfigError for one that cannot be read."""
    raw = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_COLOR)
    if raw is None:
        raise ConfigError(f"{path}: not an image that OpenCV can read; replace it")
    if raw.dtype == np.uint8:
        return np.asarray(raw, np.uint8)
    top = max(float(raw.max()), 1e-9) if np.isfinite(raw).all() else 0.0
    if top == 0.0:
        raise ConfigError(f"{path}: holds values that are not finite; convert it to 8 or 16 bits")
    return (np.clip(raw, 0, None).astype(np.float64) * (255.0 / top)).round().astype(np.uint8)


def images(files: list[Path], way: Enhancer, options: Options, show: Callable[[int, int], None]) -> list[str]:
    problems, used = [], set[str]()
    for done, path in enumerate(files, start=1):
        try:
            image = read(path)
        except ConfigError as error:
            problems.append(str(error))
        else:
            name = f"{path.stem}.png" if f"{path.stem}.png" not in used else f"{path.name}.png"
            used.add(name)
            write(options.out / name, shown(image, way, options), path)
        show(done, len(files))
    return problems


def camera(url: str, frames: int, way: Enhancer, options: Options, show: Callable[[int, int], None]) -> list[str]:
    """Some frames of a camera; the end of a video: or stack: is no mistake once one frame has come."""
    device = open_camera(url, Path(), None)
    try:
        for done in range(frames):
            try:
                frame = device.read(timeout_s=READ_TIMEOUT_S)
            except CameraGone:
                if done == 0 or not url.startswith("video:"):
                    raise
                break
            write(options.out / f"{done:06d}.png", shown(frame.image, way, options), None)
            show(done + 1, frames)
    finally:
        device.close()
    return []


def video(path: Path, way: Enhancer, options: Options, show: Callable[[int, int], None]) -> list[str]:
    """The whole of it, or its first frames, as MP4 at the same rate."""
    capture = cv2.VideoCapture(str(path))
    rate, count = capture.get(cv2.CAP_PROP_FPS) or 30.0, int(capture.get(cv2.CAP_PROP_FRAME_COUNT))
    total = min(count, options.frames) if options.frames else count
    target, sink, done = options.out / f"{path.stem}.mp4", None, 0
    protect(target, path)
    try:
        for image in stills(capture, options.frames):
            result = shown(image, way, options)
            if sink is None:
                size = (result.shape[1], result.shape[0])
                sink = cv2.VideoWriter(str(target), cv2.VideoWriter.fourcc(*"mp4v"), rate, size)
            sink.write(result)
            done += 1
            show(done, max(total, done))
    finally:
        capture.release()
        if sink is not None:
            sink.release()
    if done == 0:
        raise ConfigError(f"{path}: not a video that OpenCV can play; convert it to H.264 in MP4")
    return []


def stills(capture: cv2.VideoCapture, most: int | None) -> Iterator[Image]:
    done = 0
    while most is None or done < most:
        got, image = capture.read()
        if not got:
            return
        yield np.asarray(image, np.uint8)
        done += 1


def shown(image: Image, way: Enhancer, options: Options) -> Image:
    result = way.apply(image)
    return np.hstack([image, result]) if options.side_by_side else result


def folder(out: Path, source: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {out}: {error.strerror}; give a folder that can be written") from None
    if source.is_dir() and out.resolve() == source.resolve():
        raise ConfigError(f"--out {out}: is the source folder, whose files stay as they are; give another one")


def protect(target: Path, source: Path | None) -> None:
    if source is not None and target.resolve() == source.resolve():
        raise ConfigError(f"{target}: would overwrite its source; give another folder with --out")


def write(target: Path, image: Image, source: Path | None) -> None:
    protect(target, source)
    if not cv2.imwrite(str(target), image):
        raise ConfigError(f"{target}: cannot be written; choose another folder with --out")
