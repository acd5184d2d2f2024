"""Camera frames and what vision made of them, as they stand in a black box: enough to run vision once more; and films
of pictures.

A frame stands there once: its picture on a channel that viewers draw, CAMERA_IMAGE or SWEEP_IMAGE, and right behind it,
on FRAME with the same sequence number, what a picture cannot say. Frames of one camera are in the order in which vision
saw them, and that order matters: where vision looks next depends on the frame before.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import msgspec
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.message import DecodeError
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.schema import build_file_descriptor_set
from msgspec import Meta
from numpy.typing import NDArray

from agent.core.codec import Refusal, decode, encode
from agent.core.config import ConfigError, writing
from agent.core.messages import Message
from agent.core.picture_head import stated_size
from agent.core.step_io import Sighting
from replay.files import channels
from replay.files.channels import Entry, Schema

# --- protobuf messages ---
# What all our protobuf messages have in common: how a file describes them, and how they say a time.


@cache
def schema(kind: Any) -> Schema:
    """What the file says about a protobuf class: its full name, and its descriptor with all that it imports."""
    return Schema(kind.DESCRIPTOR.full_name, "protobuf", build_file_descriptor_set(kind).SerializeToString())


def stamp(t_ns: int) -> Timestamp:
    return Timestamp(seconds=t_ns // 10**9, nanos=t_ns % 10**9)


# --- compressed images ---
# foxglove.CompressedImage: a picture as viewers draw it, and as replay reads it again.


def image(robot: str, data: bytes, format_: str, t_ns: int) -> Any:
    """The message of one picture; `format_` is jpeg or png."""
    return CompressedImage(timestamp=stamp(t_ns), frame_id=f"{robot}/camera", data=data, format=format_)


def compressed(message: bytes) -> bytes:
    """The JPEG or PNG in the bytes of such a message. Raises Refusal where they are none."""
    try:
        return bytes(CompressedImage.FromString(message).data)
    except DecodeError:
        raise Refusal("garbage", "is no foxglove.CompressedImage") from None


# --- camera frames ---

# Of a JPEG: 60 kB for a full frame of 640x480 with sensor noise, 1.1 ms; PNG: 520 kB, 16 ms. Colour is kept at full
# resolution, unlike a JPEG's habit: it is by their colour that balls are found. That costs a quarter more bytes, and
# vision sees a centre 0.06 px from where it was, not 0.2 px (median), and 0.3 px at worst, not 2 px.
JPEG = [*(cv2.IMWRITE_JPEG_QUALITY, 90), *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)]
# Of a frame between sweeps, where no survey is swept, nothing is measured but an outline: it has half the bytes, and a
# centre lies 0.03 px from where it was, not 0.02 px (median of 402 frames of a swim; 95 %: 0.17 px, not 0.13 px). Its
# clarity is no longer that of then: of no use for a frame that is swept.
COARSE = [
    *(cv2.IMWRITE_JPEG_QUALITY, 80),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
    *(cv2.IMWRITE_JPEG_OPTIMIZE, 1),
]
PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
# So many frames to one that is kept as PNG: on it `check --vision` holds vision to every bit. A dive of 45 s has two or
# three of them, of 0.5 MB each: a tenth of a black box.
EXACT_EVERY = 128
# A sweep measures in the part of the frame around its target, and is recorded so, though vision had more to look at:
# of a robot that looks for tags in the same frames whole ones are three quarters of a black box. One in so many stays
# whole, and with them all that are kept as PNG.
WHOLE_EVERY = 16
MAX_PIXELS = 32 * 10**6  # of an image that is decoded: twice the largest sensor of a small camera
MAX_FRAME = 16 * 1024 * 1024  # bytes of a Picture: for `codec.decode`

Format = Literal["jpeg", "png"]


class Picture(Message, frozen=True, kw_only=True):
    """One frame as vision got it, on the channel FRAME. Its image and its Sighting have the same sequence."""

    t_ns: int  # middle of the exposure
    frame: int  # as the camera counts
    roi: tuple[int, int, int, int]  # x, y, width, height in the full frame
    sweep: int = 0  # the plan it belongs to; 0: none
    index: int = -1  # which position of that plan
    focus: int | None = None
    format: Format
    data: Annotated[bytes, Meta(max_length=MAX_FRAME)] = b""  # none in the file: see Frames; older files have it here


def frame_entries(
    robot: str,
    number: int,
    now_ns: int,
    pixels_: NDArray[np.uint8],
    roi: tuple[int, int, int, int],
    sighting: Sighting,
    lossless: bool,
    coarse: bool = False,
) -> tuple[Entry, Entry]:
    """A frame as it is recorded: picture, and what belongs to it; `pixels_` is (height, width, 3), blue green red.

    coarse: no clarity is measured in it. A full backlog loses the picture first.
    """
    format_: Format = "png" if lossless or number % EXACT_EVERY == 0 else "jpeg"
    _, data = cv2.imencode(f".{format_}", pixels_, PNG if format_ == "png" else COARSE if coarse else JPEG)
    shown = image(robot, data.tobytes(), format_, sighting.t_ns)
    about = Picture(
        t_ns=sighting.t_ns,
        frame=sighting.frame,
        roi=roi,
        sweep=sighting.sweep,
        index=sighting.index,
        focus=sighting.focus,
        format=format_,
    )
    # Those of a sweep show a part only, each another one: a channel of their own keeps the picture still.
    channel = channels.SWEEP_IMAGE if sighting.sweep else channels.CAMERA_IMAGE
    picture = Entry(
        channels.name(channel, robot=robot), now_ns, sighting.t_ns, number, shown.SerializeToString(),
        channel.encoding, {}, schema(shown.__class__), expendable=True,
    )  # fmt: skip
    return picture, channels.entry_on(channels.FRAME, now_ns, sighting.t_ns, number, encode(about))


def part_of(
    pixels_: NDArray[np.uint8], roi: tuple[int, int, int, int], part: tuple[int, int, int, int]
) -> NDArray[np.uint8]:
    """The part of the full frame, of the image of its region `roi`. Raises ValueError where it is not inside."""
    x, y, width, height = part
    left, top = x - roi[0], y - roi[1]
    if min(left, top) < 0 or left + width > roi[2] or top + height > roi[3]:
        raise ValueError(f"{part} is not within {roi}")
    return pixels_[top : top + height, left : left + width]


class Frames:
    """Puts the frames of a recording together again. Give it every message in the order of the file."""

    def __init__(self) -> None:
        self._image: tuple[int, bytes] | None = None
        self._about: tuple[int, bytes] | None = None

    def take(self, channel: str, sequence: int, data: bytes) -> None:
        """Keep what belongs to the newest frame; other messages pass by."""
        if channel == channels.FRAME.name:
            self._about = sequence, data
        elif channels.shows_frame(channel):
            self._image = sequence, data

    def at(self, sequence: int) -> Picture | None:
        """The frame of the Sighting with this sequence number; None where the file has lost its picture.

        Raises Refusal for messages that are none.
        """
        if self._about is None or self._about[0] != sequence:
            return None
        about = decode(self._about[1], Picture, MAX_FRAME)  # our own message, not a stranger's
        if about.data:
            return about
        if self._image is None or self._image[0] != sequence:
            return None
        return msgspec.structs.replace(about, data=compressed(self._image[1]))


def pixels(of: Picture) -> NDArray[np.uint8]:
    """The image of a record, (height, width, 3), blue green red. Raises ConfigError where it does not decode."""
    size = stated_size(of.data)
    image = None
    if size is not None and 0 < size[0] * size[1] <= MAX_PIXELS:  # before memory is taken for it
        with contextlib.suppress(cv2.error):
            image = cv2.imdecode(np.frombuffer(of.data, np.uint8), cv2.IMREAD_COLOR)
    if image is None:
        raise ConfigError(f"frame {of.frame}: its {of.format} is broken; run `aucamp replay recover` on the file")
    return image.astype(np.uint8, copy=False)


# --- films that are written ---

CODECS = {".mp4": "mp4v", ".avi": "MJPG"}  # by the end of the name: what every OpenCV writes
MARGIN = bytes(4096)  # that has to fit on the disk behind a film: else its own end may not have


class Film:
    """Frames of one size, the first one's; an odd side is one longer in the film, by its last column or row again.

    The library that writes them cuts odd sides, and keeps to itself what goes wrong.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path, self._rate_hz = path, rate_hz
        self._writer: cv2.VideoWriter | None = None
        self._size, self._count = (0, 0), 0

    def add(self, image: NDArray[np.uint8]) -> None:
        """(height, width, 3), blue green red. Raises OSError where no film can be written."""
        size = image.shape[1], image.shape[0]
        if self._writer is None:
            self._path.open("ab").close()  # says why, where it cannot be
            codec = cv2.VideoWriter.fourcc(*CODECS[self._path.suffix.lower()])
            even = size[0] + size[0] % 2, size[1] + size[1] % 2
            self._writer, self._size = cv2.VideoWriter(str(self._path), codec, self._rate_hz, even), size
            if not self._writer.isOpened():
                raise OSError(errno.EIO, f"no film of {size[0]} x {size[1]} pixels can be written", str(self._path))
        if size != self._size:
            raise ValueError(f"a frame of {size} pixels in a film of {self._size}")
        self._writer.write(cv2.copyMakeBorder(image, 0, size[1] % 2, 0, size[0] % 2, cv2.BORDER_REPLICATE))
        self._count += 1

    def finish(self) -> None:
        """Raises OSError where what is on the disk is not the film."""
        self.release()
        if not self._count:
            return
        with writing(self._path), self._path.open("r+b", buffering=0) as file:
            end = file.seek(0, 2)
            file.write(MARGIN)
            file.truncate(end)
        written = cv2.VideoCapture(str(self._path))
        count = int(written.get(cv2.CAP_PROP_FRAME_COUNT))
        written.set(cv2.CAP_PROP_POS_FRAMES, self._count - 1)
        whole = count == self._count and written.read()[0]
        written.release()
        if not whole:
            raise OSError(errno.EIO, "the film could not be written to its end", str(self._path))

    def release(self) -> None:
        if self._writer is not None:
            self._writer.release()
        self._writer = None


@contextlib.contextmanager
def film(path: Path, rate_hz: float) -> Iterator[Film]:
    """A new film, whole after the block; where it breaks off the file is taken away: half a film looks like a whole
    one. Raises OSError."""
    made = Film(path, rate_hz)
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # a line for each frame that finds no room
    try:
        yield made
        made.finish()
    except BaseException:
        made.release()
        path.unlink(missing_ok=True)
        raise
    finally:
        cv2.utils.logging.setLogLevel(level)
