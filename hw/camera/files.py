"""Recorded pictures as cameras, stack: and video:, and the picture files that a folder holds.

A stack is a directory of photographs of one still scene at different focus positions, and a `positions.csv` with
the columns file and focus_position (any unit; rows in any order). Setting the focus chooses the photograph.
"""

from __future__ import annotations

import csv
import io
import itertools
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from agent.clock import machine
from agent.core.codec import as_text, printable
from agent.core.config import ConfigError, inside, read_file, write_whole
from agent.core.picture_head import (
    OTHER_PICTURES,
    PICTURES,
    UPRIGHT,
    cut_off,
    kind_of,
    orientation,
    several,
    stated_size,
)
from hw.camera.camera import (
    PATIENCE_S,
    CameraError,
    CameraGone,
    FocusRange,
    Frame,
    Image,
    Roi,
    Stamp,
    deliverable,
    nearest,
)

# --- picture files ---

KINDS = "a PNG, JPEG, BMP, TIFF or WebP"  # picture_head.PICTURES: their heads can be read before they are decoded
SUFFIXES = (".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp")
RAW = (".dng", ".nef", ".arw", ".cr2", ".cr3", ".raf", ".orf", ".rw2", ".pef", ".srw")  # inside often a TIFF
MOST_BYTES = 2**30  # of a picture's file
MOST_PIXELS = 2**28  # that its head may state: more than any sensor has, and 800 MB of memory
HEAD_BYTES = 2**18  # in which EXIF stands
NAMED = 5  # files in a line; more are counted


class Folder(NamedTuple):
    """What of a folder are pictures."""

    files: list[Path]  # that can be read, or are named as if they could; in the order of their names, 9 before 10
    left_out: list[str]  # pictures of other kinds, a line for each


def folder_of_pictures(folder: Path) -> Folder:
    """By first bytes and by name. Raises ConfigError if there are none."""
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; give a folder of pictures")
    files, left_out = [], []
    for path in sorted((path for path in folder.iterdir() if not path.name.startswith(".")), key=as_numbered):
        kind = _kind(path)
        if kind in OTHER_PICTURES:
            left_out.append(f"{path}: {_unread(kind)}")
        elif kind in PICTURES or path.suffix.lower() in SUFFIXES:
            files.append(path)
    if not files:
        others = f"; {left_out[0].rpartition('/')[2]}" if left_out else f"; it needs {KINDS}"
        raise ConfigError(f"{folder}: no pictures in this folder{others}")
    return Folder(files, left_out)


def as_numbered(path: Path) -> tuple[list[str | int], str]:
    """What files are sorted by so that numbers in their names count as numbers."""
    return [int(part) if k % 2 else part for k, part in enumerate(re.split(r"([0-9]+)", path.name))], path.name


def picture_files(folder: Path) -> list[Path]:
    """The same where other kinds of pictures concern nobody."""
    return folder_of_pictures(folder).files


def turned(paths: Sequence[Path]) -> str | None:
    """One line about pictures that EXIF says to turn; None: there are none.

    Where pixels are measured they are counted as the sensor has them: a lens does not turn with the hand.
    """
    held = {path.name: orientation(_head(path)) for path in paths}
    names = [name for name, how in held.items() if how != UPRIGHT]
    if not names:
        return None
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return (
        f"{len(names)} of {len(paths)} pictures have an EXIF orientation, which is not followed: pixels are counted as "
        f"the sensor has them ({', '.join(names[:NAMED])}{more})"
    )


def _head(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES)
    except OSError:  # a folder, or gone: its reader says so
        return b""


def _kind(path: Path) -> str | None:
    if not path.is_file():
        return None
    kind = kind_of(_head(path)[:64])
    return "camera raw" if kind == "TIFF" and path.suffix.lower() in RAW else kind


def _unread(kind: str) -> str:
    return f"is {kind}, which is not read; convert it to PNG or JPEG"


def is_picture(path: Path) -> bool:
    """Whether a file is one, readable or not, and no film."""
    kind = _kind(path)
    return kind in PICTURES | OTHER_PICTURES or (kind is None and path.suffix.lower() in SUFFIXES)


def read_picture(
    path: Path, grey: bool = False, stretch: bool = False, upright: bool = False, white: float | None = None
) -> NDArray[np.uint8]:
    """A picture as (height, width, 3) blue green red, or as (height, width) luminance if it is to be `grey`.

    Pixels are as the sensor has them; `upright` turns them as EXIF says, for people who look at them. A grey file
    becomes three equal colours, an alpha plane is left out. More than 8 bits are scaled so that `white` becomes 255;
    None: the largest value that the type holds (1 for floating point), so that pictures stay comparable. `stretch`
    scales by the picture's own largest value, for what is looked at by itself: many cameras write 12 bits into a file
    of 16, which would come out nearly black.

    Raises ConfigError for a file that is not there, cannot be read, is cut off or holds several pictures, and for
    values that are not finite.
    """
    raw = _decoded(path, grey, upright)
    if raw.dtype == np.uint8:
        return np.asarray(raw, np.uint8)
    if stretch:
        white = max(float(raw.max()), 1e-9)
    elif white is None:
        white = 1.0 if raw.dtype.kind == "f" else float(np.iinfo(raw.dtype.str).max)
    return np.asarray((np.clip(raw, 0, white).astype(np.float64) * (255.0 / white)).round(), np.uint8)


def white_of_all(paths: Iterable[Path]) -> float | None:
    """The largest value of as many bits as some pictures of 16 use together; None: they are of another type.

    A gain of its own for each photograph of a focus stack would move the peaks of clarity. Raises as `read_picture`.
    """
    most = 0
    for path in paths:
        raw = _decoded(path, grey=False, upright=False)
        if raw.dtype != np.uint16:
            return None
        most = max(most, int(raw.max()))
    return float((1 << max(most.bit_length(), 8)) - 1)


def _decoded(path: Path, grey: bool, upright: bool) -> NDArray[Any]:
    """A picture as it is in the file. Raises as `read_picture`."""
    data = read_file(path, MOST_BYTES, "give a picture")
    kind = _kind(path)
    if kind in OTHER_PICTURES:
        raise ConfigError(f"{path}: {_unread(kind)}")
    size = stated_size(data)
    width, height = size or (0, 0)
    if width * height > MOST_PIXELS:  # before memory is taken for it
        raise ConfigError(f"{path}: says that it has {width} x {height} pixels; give a smaller picture")
    if size is not None and cut_off(data):
        raise ConfigError(f"{path}: not an image that OpenCV can read: it is cut off before its end; copy it again")
    if several(data):
        raise ConfigError(f"{path}: holds several pictures; save each as a file of its own, and give their folder")
    raw = None
    if size is not None:
        with _quiet(), suppress(cv2.error, MemoryError):
            raw = _pixels(data, grey, upright, kind)
    if raw is None:
        what = "" if kind is None or kind in PICTURES else f" (it is {kind})"
        raise ConfigError(f"{path}: not an image that OpenCV can read{what}; give {KINDS}")
    if not np.isfinite(raw).all():
        raise ConfigError(f"{path}: holds values that are not finite; convert it to 8 or 16 bits")
    return np.asarray(raw)


def _pixels(file: bytes, grey: bool, upright: bool, kind: str | None) -> NDArray[Any] | None:
    data = np.frombuffer(file, np.uint8)
    how = cv2.IMREAD_ANYDEPTH | (0 if upright else cv2.IMREAD_IGNORE_ORIENTATION)
    if kind == "TIFF":  # whose floating point OpenCV reads only with as many colours as the file has
        raw = cv2.imdecode(data, how | cv2.IMREAD_ANYCOLOR)
        if raw is not None and raw.dtype.kind == "f" and grey and raw.ndim == 3:
            return np.asarray(raw @ np.array(LUMINANCE))
        if raw is not None and raw.ndim == 2 and not grey:
            return np.repeat(raw[:, :, None], 3, axis=2)
        if raw is None or raw.ndim == (2 if grey else 3):
            return raw
    return cv2.imdecode(data, how | (cv2.IMREAD_GRAYSCALE if grey else cv2.IMREAD_COLOR))


LUMINANCE = (0.114, 0.587, 0.299)  # of blue, green and red: ITU-R BT.601, as OpenCV has it


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV writes nothing of what it cannot decode: whoever asked says it in one line."""
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def write_picture(path: Path, image: NDArray[np.uint8] | NDArray[np.uint16]) -> None:
    """As PNG. Raises OSError, which names the file."""
    _, data = cv2.imencode(".png", image)  # of whole numbers it always is one
    write_whole(path, data.tobytes())


# --- tables ---


def rows(text: str) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """A table with a line of names: the names, and for each further line its number and its cells by name.

    Cells are parted by what the first line has most of: commas, semicolons or tabs. Where it is no comma, a comma in a
    number is a decimal one. Raises csv.Error, also for a line of more cells than there are names.
    """
    first = next((line for line in text.splitlines() if line.strip()), "")
    mark = max(",;\t", key=first.count)  # of equals the first
    reader = csv.reader(io.StringIO(text), delimiter=mark, skipinitialspace=True)
    names, found = None, list[tuple[int, dict[str, str]]]()
    for read in reader:
        cells = [printable(cell) for cell in read]
        if not any(cell.strip() for cell in cells):
            continue
        if names is None:
            names = [cell.strip() for cell in cells]
            continue
        if len(cells) > len(names):
            raise csv.Error(f"line {reader.line_num} has {len(cells)} cells, and there are {len(names)} columns")
        cells += [""] * (len(names) - len(cells))
        if mark != ",":
            cells = [DECIMAL_COMMA.sub(r"\1.\2", cell) for cell in cells]
        found.append((reader.line_num, dict(zip(names, cells, strict=True))))
    return names or [], found


DECIMAL_COMMA = re.compile(r"^(\s*[-+]?\d*),(\d+(?:[eE][-+]?\d+)?\s*)$")


def read_rows(path: Path) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """A CSV file as `rows` has it: names, and lines with their numbers. Raises ConfigError."""
    give = "save the table as CSV in UTF-8"
    try:
        return rows(as_text(read_file(path, MOST_TABLE_BYTES, "give a CSV file")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(f"{path}: cannot be read as a table, not a CSV file ({error}); {give}") from None


MOST_TABLE_BYTES = 2**24  # a line for each frame of an hour

# --- stack of photographs ---

POSITIONS = "positions.csv"
COLUMNS = ("file", "focus_position")
MIN_PHOTOGRAPHS = 3  # a focus peak has a top and two flanks; five are fitted


class Photograph(NamedTuple):
    focus_position: float  # in the unit of positions.csv
    path: Path


def open_stack(directory: Path) -> StackCamera:
    """Read positions.csv. Raises CameraError; photographs are read when they are asked for."""
    photographs = _read_positions(directory)
    try:
        white = white_of_all(photograph.path for photograph in photographs)
    except ConfigError as error:
        raise CameraError(f"{error}, and its row out of {POSITIONS}") from None
    return StackCamera(photographs, _load(photographs[0].path, white), white)


class StackCamera:
    """Lens positions are 0, 1, ... in the order of focus_position. Nothing moves, so nothing is waited for."""

    def __init__(self, photographs: list[Photograph], first: Image, white: float | None) -> None:
        """first: the photograph at lens position 0. white: of all, as `read_picture` takes it."""
        self._white = white
        self.size = (first.shape[1], first.shape[0])
        self.stamp: Stamp = "exposure-start"
        self._photographs = photographs
        self._lens_position = 0
        self._image: Image | None = first
        self._seq = 0

    @property
    def positions(self) -> tuple[float, ...]:
        """focus_position of each lens position, increasing."""
        return tuple(photograph.focus_position for photograph in self._photographs)

    @property
    def names(self) -> tuple[str, ...]:
        """File name of each lens position."""
        return tuple(photograph.path.name for photograph in self._photographs)

    def focus_range(self) -> FocusRange:
        return FocusRange(0, len(self._photographs) - 1, 1)

    def set_focus(self, lens_position: int) -> int:
        wanted = nearest(lens_position, self.focus_range())
        if wanted != self._lens_position:
            self._lens_position, self._image = wanted, None
        return wanted

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        if self._image is None:
            self._image = self._photograph()
        frame = _frame(machine.monotonic_ns(), self._seq, self._image, roi)
        self._seq += 1
        return frame

    def close(self) -> None:
        self._image = None

    def _photograph(self) -> Image:
        path = self._photographs[self._lens_position].path
        image = _load(path, self._white)
        size = (image.shape[1], image.shape[0])
        if size != self.size:
            width, height = self.size
            first = self._photographs[0].path.name
            raise CameraError(
                f"{path}: {size[0]}x{size[1]} pixels, but {first} has {width}x{height}; "
                "the photographs of a stack must be of one size"
            )
        return image


def _load(path: Path, white: float | None) -> Image:
    if not path.is_file():
        raise CameraGone(f"{path}: the photograph has gone; put it back")
    try:
        return read_picture(path, white=white)
    except ConfigError as error:
        raise CameraError(f"{error}, and its row out of {POSITIONS}") from None


def _read_positions(directory: Path) -> list[Photograph]:
    if not directory.is_dir():
        raise CameraError(f"{directory}: no such directory; give one with photographs and {POSITIONS}")
    path = directory / POSITIONS
    wanted = ",".join(COLUMNS)
    if not path.exists():
        raise CameraError(f"{path} is missing; write one with the columns {wanted}")
    try:
        names, table = read_rows(path)
    except ConfigError as error:
        raise CameraError(str(error)) from None
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise CameraError(f"{path}: no column {' and '.join(missing)}; the first line must be {wanted}")
    photographs = [_photograph(row, directory, f"{path}: line {number}") for number, row in table]
    twice = [name for name, count in Counter(one.path.name for one in photographs).items() if count > 1]
    if twice:
        raise CameraError(f"{path}: {twice[0]} stands in more than one row; give each row its own photograph")
    photographs.sort()
    if len(photographs) < MIN_PHOTOGRAPHS:
        raise CameraError(f"{path}: {len(photographs)} photographs are no stack; give five or more")
    for one, next_one in itertools.pairwise(photographs):
        if one.focus_position == next_one.focus_position:
            both = f"{one.path.name} and {next_one.path.name}"
            raise CameraError(f"{path}: {both} have the same focus_position; keep one of them")
    return photographs


def _photograph(row: dict[str, str], directory: Path, where: str) -> Photograph:
    name, focus_position = (row[column] for column in COLUMNS)
    try:
        value = float(focus_position)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise CameraError(f"{where}: focus_position {focus_position!r} is not a number; correct it")
    try:
        path = inside(directory, name)
    except ConfigError as error:
        raise CameraError(f"{where}: {error}") from None
    if not path.is_file():
        raise CameraError(f"{where}: there is no file '{name}' in {directory}; correct the name or remove the row")
    return Photograph(value, path)


# --- video ---

FEW_UNREAD = 250  # frames in a row that cannot be decoded: where the file announces no more, they are its end
MOST_UNREAD = 10_000  # the same where it does: a film of an hour of which minutes are left is not tried to its end


def open_video(path: Path, upright: bool = False) -> VideoCamera:
    """Frames are as the sensor has them; `upright` turns them as the file says, for people who look at them.

    Raises CameraError if OpenCV cannot play the file.
    """
    if not path.is_file():
        raise CameraError(f"{path}: no such file; give the path of a video")
    capture = cv2.VideoCapture(str(path))
    if not capture.isOpened():
        kind = _kind(path)
        what = f" (it is {kind})" if kind else ""
        raise CameraError(f"{path}: not a video that OpenCV can play{what}; convert it to H.264 in MP4")
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, float(upright))  # OpenCV turns them by default
    return VideoCamera(capture, path)


class VideoCamera:
    """Each read is the next frame of the file that can be decoded, stamped with the file's own time, which begins at 0.

    A frame's number counts those before it that cannot be decoded; `unread` has their numbers. No focus.
    """

    def __init__(self, capture: cv2.VideoCapture, path: Path) -> None:
        self.size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
        self.stamp: Stamp = "exposure-start"
        self.count = max(int(capture.get(cv2.CAP_PROP_FRAME_COUNT)), 0)  # that the file announces; 0: it does not
        self.rate_hz = capture.get(cv2.CAP_PROP_FPS) or 30.0
        self.turn_deg = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 360  # by which the file is to be turned
        self.unread: list[int] = []  # so far, from 0; those after the last frame that can be decoded are not in it
        self._capture = capture
        self._path = path
        self._seq = 0

    def focus_range(self) -> FocusRange | None:
        return None

    def set_focus(self, lens_position: int) -> int:
        raise CameraError(f"{self._path}: the focus of a video cannot be set; use a camera or a stack: of photographs")

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        most = min(max(self.count - self._seq, FEW_UNREAD), MOST_UNREAD)
        tries = (self._capture.read() for _ in range(most))  # OpenCV says the same of a broken frame as of the end
        failed, image = next(((n, image) for n, (got, image) in enumerate(tries) if got), (0, None))
        if image is None:
            raise CameraGone(f"{self._path}: end of the video after {self._seq} frames")
        self.unread += range(self._seq, self._seq + failed)
        self._seq += failed
        t_ns = round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)  # of the frame just read
        frame = _frame(t_ns, self._seq, np.asarray(image, np.uint8), roi)
        self._seq += 1
        return frame

    def close(self) -> None:
        self._capture.release()


def _frame(t_ns: int, seq: int, image: Image, roi: Roi | None) -> Frame:
    """What `roi` asks for of a recorded picture."""
    part = deliverable(roi, (image.shape[1], image.shape[0]))
    pixels = image[part.y : part.y + part.height, part.x : part.x + part.width].copy()
    return Frame(t_ns, seq, pixels, part, still=True)
