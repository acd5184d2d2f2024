"""`aucamp enhance SOURCE`: an image, a folder of images, a video or a camera, written enhanced to another folder.
Sources of pictures by name, and pairs of pictures from two folders.

The output is always 8-bit colour, PNG for images and for the frames of a camera, MP4 for videos.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Literal, NamedTuple

import cv2
import numpy as np
from rich.console import Console

from agent.core.config import ConfigError
from agent.perception.enhancement.enhance import BUDGET_MS, Image, Variant, enhancer, needs_nothing
from agent.process.command import Progress, new_file, new_folder, with_bar
from hw.camera import open_camera
from hw.camera.camera import Camera, CameraGone, Frame
from hw.camera.files import (
    SUFFIXES,
    VideoCamera,
    folder_of_pictures,
    is_picture,
    open_video,
    picture_files,
    read_picture,
    turned,
    write_picture,
)
from replay.files.frames import CODECS, film

# --- sources of pictures ---
# A source of pictures by name: an image, a folder of images, a video file, or the address of a camera.

READ_TIMEOUT_S = 2.0  # a camera that has just been opened takes longer than one that runs
WHOLE = 0.98  # of the frames that a video announces: files without an index state an estimate


class Picture(NamedTuple):
    name: str  # of the file; of a video or a camera the number of the frame, from 0, those that cannot be read counted
    t_s: float | None  # from the first picture on; None for images
    image: Image  # (height, width, 3), blue green red
    place: int  # in the source, from 0: pictures that cannot be read have theirs too


class Pictures(NamedTuple):
    """Walk through `each` once; a camera is open until the walk ends.

    `problems` and `notes` grow on the way, a line for each: what could not be read, so that a command ends with exit
    code 1; and what a person should know of the pictures.
    """

    kind: Literal["images", "video", "camera"]
    each: Iterator[Picture]
    total: int | None  # None where only the end of the source tells
    rate_hz: float | None  # of a film
    problems: list[str]
    notes: list[str]


def pictures(source: str, frames: int | None, of_camera: int | None = None, upright: bool = False) -> Pictures:
    """`frames` ends the walk early. A camera never ends: it needs `frames`, or `of_camera` in its place.

    upright: images are turned as EXIF says and videos as their files say; else pixels are the sensor's. Raises
    ConfigError, and CameraError as the camera does; the walk raises where not one picture can be read.
    """
    place = Path(source)
    problems, notes = list[str](), list[str]()
    if place.is_dir():
        found = folder_of_pictures(place)
        problems += found.left_out
        paths = found.files[:frames]
        notes += [] if upright else said(turned(paths))
        return Pictures("images", _images(paths, problems, upright), len(paths), None, problems, notes)
    if place.is_file() and is_picture(place):
        notes += [] if upright else said(turned([place]))
        one = iter([Picture(place.name, None, read_picture(place, stretch=True, upright=upright), 0)])
        return Pictures("images", one, 1, None, problems, notes)
    most = frames or of_camera
    if place.is_file():
        return _film(place, "video", frames, upright)
    if source.startswith("video:") and source != "video:":
        return _film(Path(source.removeprefix("video:")), "camera", most, upright)
    if ":" not in source:
        raise ConfigError(f"{source}: no such file or folder; give one, or the address of a camera (v4l2:/dev/video0)")
    if most is None:
        raise ConfigError(f"{source}: a camera never ends; say how many frames with --frames")
    return Pictures("camera", _shots(source, most), most, None, problems, notes)


def first_of(found: Pictures) -> tuple[Picture, Pictures]:
    """The first picture, which there is, or the walk says why not; and all of them, with it."""
    first = next(found.each)
    return first, found._replace(each=itertools.chain((first,), found.each))


def said(line: str | None) -> list[str]:
    return [] if line is None else [line]


def _images(paths: list[Path], problems: list[str], upright: bool) -> Iterator[Picture]:
    read = 0
    for k, path in enumerate(paths):
        try:
            image = read_picture(path, stretch=True, upright=upright)  # each is looked at by itself
        except ConfigError as error:
            problems.append(str(error))
        else:
            read += 1
            yield Picture(path.name, None, image, k)
    if not read:
        raise ConfigError(f"not one of {len(paths)} pictures can be read: {problems[-1]}")


def _film(path: Path, kind: Literal["video", "camera"], frames: int | None, upright: bool) -> Pictures:
    camera = open_video(path, upright)
    count = min(frames or camera.count, camera.count)
    problems, notes = list[str](), list[str]()
    if camera.turn_deg and not upright:
        how = "which is not followed: pixels are counted as the sensor has them"
        notes.append(f"{path}: says that it is to be turned by {camera.turn_deg} degrees, {how}")
    each = _frames(camera, path, frames, count, problems, notes)
    return Pictures(kind, each, count or None, camera.rate_hz, problems, notes)


def _frames(
    camera: VideoCamera, path: Path, frames: int | None, count: int, problems: list[str], notes: list[str]
) -> Iterator[Picture]:
    """count: how many there should be; 0: nobody knows."""
    stale = Stale()
    with closing(camera):
        shots = itertools.takewhile(lambda frame: frames is None or frame.seq < frames, _read(camera, frames))
        first = next(shots, None)
        if first is None:
            raise ConfigError(f"{path}: not one frame can be read; convert it to H.264 in MP4")
        second = next(shots, None)
        # A stream without times says 0 for all of them.
        timed = second is None or second.t_ns > first.t_ns
        if not timed:
            notes.append(f"{path}: its frames have no times, so that t_s is left empty; convert it to MP4")
        for frame in itertools.chain([first], [] if second is None else [second], shots):
            stale.look(frame.image, frame.seq)
            yield Picture(str(frame.seq), (frame.t_ns - first.t_ns) * 1e-9 if timed else None, frame.image, frame.seq)
            last = frame.seq
    unread = [n for n in camera.unread if frames is None or n < frames]
    number = max([last, *unread]) + 1
    if unread:
        which = f"{path}: {_numbered(unread)} cannot be read"
        problems.append(f"{which}, {len(unread)} of {count or number}; copy or convert it again")
    if number < WHOLE * count:
        problems.append(f"{path}: ends after {number} of {count} frames; it was cut off, copy or convert it again")
    elif number < count:
        notes.append(f"{path}: says that it has {count} frames, and ends after {number}: some may be lost at its end")
    elif not count and (frames is None or number < frames):
        notes.append(
            f"{path}: does not say how many frames it has: some may be lost after its {number}; convert it to MP4"
        )
    if stale.runs() == [(first.seq, last)]:
        convert = "if it is interlaced, convert it first: ffmpeg -i FILM -vf yadif NEW.mp4"
        problems.append(f"{path}: all {number} frames are the same picture; {convert}")
    else:
        notes += [f"{path}: frames {begin} to {end} are the same picture" for begin, end in stale.runs()]


def _numbered(numbers: Sequence[int]) -> str:
    """Rising numbers of frames, those in a row together."""
    runs: list[list[int]] = []
    for n in numbers:
        if runs and n == runs[-1][1] + 1:
            runs[-1][1] = n
        else:
            runs.append([n, n])
    shown = [f"{begin}" if begin == end else f"{begin} to {end}" for begin, end in runs[:NAMED]]
    more = f" and {sum(end - begin + 1 for begin, end in runs[NAMED:])} more" if len(runs) > NAMED else ""
    return f"frame{'s' if len(numbers) > 1 else ''} {', '.join(shown)}{more}"


STALE_FRAMES = 10  # in a row: a camera that stood still has noise, and one that hung has none


class Stale:
    """Looks for frames in a row that are the same picture, bit for bit."""

    def __init__(self) -> None:
        self._last: Image | None = None
        self._begin = self._end = 0  # of the run that goes on
        self._ended: list[tuple[int, int]] = []

    def look(self, image: Image, number: int) -> None:
        """The next frame, and its number."""
        if self._last is None or not np.array_equal(self._last, image):
            self._ended, self._begin = self.runs(), number
        self._last, self._end = image, number

    def runs(self) -> list[tuple[int, int]]:
        """First and last frame of each run longer than STALE_FRAMES."""
        now = self._begin, self._end
        return [*self._ended, now] if now[1] - now[0] >= STALE_FRAMES else self._ended


def _read(camera: Camera, frames: int | None) -> Iterator[Frame]:
    """Until a film's end."""
    for _ in itertools.count() if frames is None else range(frames):
        try:
            yield camera.read(timeout_s=READ_TIMEOUT_S)
        except CameraGone:
            if not isinstance(camera, VideoCamera):
                raise
            return


def _shots(url: str, frames: int | None) -> Iterator[Picture]:
    first_ns = None
    with closing(open_camera(url, Path(), None)) as camera:
        for number, frame in enumerate(_read(camera, frames)):
            first_ns = frame.t_ns if first_ns is None else first_ns
            yield Picture(str(number), (frame.t_ns - first_ns) * 1e-9, frame.image, number)


# --- `aucamp enhance` ---

FRAMES = 30  # of a camera, unless told


class Change(NamedTuple):
    """What became of one picture."""

    name: str
    levels: float  # of 255, by which it changed in the mean
    kept: float  # share of it that stayed, for it needs nothing


Render = Callable[[Picture], Image]


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
    one = out.suffix.lower() in SUFFIXES or out.suffix.lower() in CODECS
    (new_file if one else new_folder)(out)
    found = pictures(source, frames, of_camera=FRAMES, upright=True)
    if one and not (found.total == 1 and found.kind == "images" and out.suffix.lower() == ".png"):
        raise ConfigError(f"--out {out}: is the name of one picture; give a folder, or for one picture a NAME.png")
    _, found = first_of(found)  # a source that cannot be read says so before anything is compiled
    way = enhancer(variant, weights, BUDGET_MS if found.kind == "camera" else None)
    if way.why:
        console.print(f"{way.variant}: {way.why}")
    changes: list[Change] = []
    render = told(way.apply, changes, side_by_side)
    make_folder(out.parent if one else out)
    if one:
        write_picture(out, render(next(found.each)))
    elif found.kind == "video":
        with_bar(console, "enhance", lambda show: enhanced_film(found, out / f"{Path(source).stem}.mp4", render, show))
    else:
        with_bar(console, "enhance", lambda show: stills(found, out, render, show))
    for note in found.notes:
        console.print(note)
    for problem in found.problems:
        console.print(f"skipped: {problem}" if found.kind == "images" else problem)
    for line in summed_up(changes, found.kind == "images"):
        console.print(line)
    console.print(f"written to {out}")
    return 1 if found.problems else 0


def told(apply: Callable[[Image], Image], changes: list[Change], side_by_side: bool) -> Render:
    """From a picture to what is written of it; how much it changed is noted."""

    def render(picture: Picture) -> Image:
        after = apply(picture.image)
        by = float(np.abs(after.astype(np.int16) - picture.image).mean())
        changes.append(Change(picture.name, by, needs_nothing(picture.image)))
        return np.hstack([picture.image, after]) if side_by_side else after

    return render


def summed_up(changes: Sequence[Change], by_name: bool) -> Iterator[str]:
    """A line for each image; of a film or a camera one for all."""
    if by_name:
        for change in changes:
            kept = f", {100 * change.kept:.0f} % of it left as it is: it needs little" if change.kept else ""
            yield f"{change.name}: changed by {change.levels:.1f} levels{kept}"
    elif changes:
        levels = sorted(change.levels for change in changes)
        spared = sum(change.kept == 1.0 for change in changes)
        yield (
            f"{len(changes)} frames: changed by {levels[len(levels) // 2]:.1f} levels in the median, "
            f"{levels[0]:.1f} to {levels[-1]:.1f}; {spared} need nothing and are as they came"
        )


def make_folder(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"--out {out}: {error.strerror}; give a folder that can be written") from None


def stills(found: Pictures, out: Path, render: Render, show: Progress) -> None:
    """One PNG for each picture, with its name or number."""
    used: set[str] = set()
    for done, picture in enumerate(found.each, start=1):
        stem = Path(picture.name).stem if found.kind == "images" else f"{int(picture.name):06d}"
        write_picture(out / own_name(stem, picture.name, used), render(picture))
        show(done, found.total or done)
    if found.total:
        show(found.total, found.total)  # with those that were skipped


def own_name(stem: str, whole: str, used: set[str]) -> str:
    """stem.png; where another picture has that already, the whole name and .png."""
    name = f"{stem}.png"
    if name in used:
        name = f"{whole}.png"
    while name in used:
        name = f"{name}.png"
    used.add(name)
    return name


def enhanced_film(found: Pictures, file: Path, render: Render, show: Progress) -> None:
    """One MP4 with the rate of the source."""
    with film(file, found.rate_hz or 30.0) as made:
        for done, picture in enumerate(found.each, start=1):
            made.add(render(picture))
            show(done, max(found.total or done, done))


# --- pairs of pictures ---
# Pairs of pictures from two folders: one that is to be enhanced, and a reference of how it should look.
#
# The layouts in use: LSUI has input/ and GT/, UIEB raw-890/ and reference-890/, EUVP Paired/<subset>/trainA/ and
# trainB/. Suffixes may differ between the two folders.

NAMED = 5  # pictures without a partner, or frames that cannot be read; more are counted

Size = tuple[int, int]  # width, height


def paired(raw: Path, reference: Path) -> tuple[list[tuple[Path, Path]], list[str]]:
    """Files of the two folders with the same name, and a line for each folder with names that the other lacks.

    Raises ConfigError if there are no pairs, and where a folder has two pictures of one name.
    """
    ours, theirs = _by_stem(raw), _by_stem(reference)
    pairs = [(path, theirs[stem]) for stem, path in ours.items() if stem in theirs]
    if not pairs:
        raise ConfigError(f"{raw} and {reference}: no two pictures of the same name; give folders that belong together")
    alone = []
    for folder, here, there in ((raw, ours, theirs), (reference, theirs, ours)):
        names = [path.name for stem, path in here.items() if stem not in there]
        if names:
            more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
            alone.append(f"{folder}: without a partner in the other folder: {', '.join(names[:NAMED])}{more}")
    return pairs, alone


def _by_stem(folder: Path) -> dict[str, Path]:
    found: dict[str, Path] = {}
    for path in picture_files(folder):
        if (other := found.setdefault(path.stem, path)) != path:
            both = f"{other.name} and {path.name}"
            raise ConfigError(f"{folder}: {both} have one name, and pictures pair up by it; leave one there")
    return found


def read_pair(raw: Path, reference: Path, size: Size | None) -> tuple[Image, Image]:
    """Both pictures of a pair, scaled to `size`; None: as they are. Raises ConfigError, also where their sizes differ.

    They are stretched as `aucamp enhance` stretches what it is given, so that training sees and figures judge what
    users get.
    """
    image, target = (read_picture(path, stretch=True, upright=True) for path in (raw, reference))
    if image.shape != target.shape:
        ours, theirs = (f"{one.shape[1]}x{one.shape[0]}" for one in (image, target))
        raise ConfigError(f"{raw}: {ours}, but its reference {theirs} pixels; a pair must show the same pixels")
    if size is None:
        return image, target
    small = [np.asarray(cv2.resize(one, size, interpolation=cv2.INTER_AREA), np.uint8) for one in (image, target)]
    return small[0], small[1]
