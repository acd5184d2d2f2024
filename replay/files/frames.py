"""Camera frames and what vision made of them, as they stand in a black box: enough to run vision once more.

A frame stands there once: its picture on a channel that viewers draw, CAMERA_IMAGE or SWEEP_IMAGE, and right behind it,
on FRAME with the same sequence number, what a picture cannot say. Frames of one camera are in the order in which vision
saw them, and that order matters: where vision looks next depends on the frame before.
"""

from __future__ import annotations

import contextlib
from functools import cache
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

from agent.core.codec import Refusal, decode, encode, stated_size
from agent.core.config import ConfigError
from agent.core.messages import Message
from agent.core.step_io import Sighting
from replay.files import channels
from replay.files.channels import Entry, Schema

# --- protobuf messages ---
# What our protobuf messages have in common, whoever makes them: how a file describes them, and how they say a time.


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
JPEG = [
    *(cv2.IMWRITE_JPEG_QUALITY, 90),
    *(cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444),
]
PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]
# So many frames to one that is kept as PNG: on it `check --vision` holds vision to every bit. A dive of 45 s has two or
# three of them, which make a black box larger by some 6 % (0.43 MB each, a JPEG 0.056 MB: 12 recordings of the twin).
EXACT_EVERY = 128
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
) -> tuple[Entry, Entry]:
    """A frame as it is recorded: picture, and what belongs to it; `pixels_` is (height, width, 3), blue green red.

    A full backlog loses the picture first.
    """
    format_: Format = "png" if lossless or number % EXACT_EVERY == 0 else "jpeg"
    _, data = cv2.imencode(f".{format_}", pixels_, PNG if format_ == "png" else JPEG)
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
