"""What a V4L2 camera delivers: choosing among size, encoding and frame rate, and reading a buffer of that kind."""

from __future__ import annotations

import errno
from typing import NamedTuple

import cv2
import numpy as np

from agent.core.codec import stated_size
from hw.camera import v4l2_calls as v4l2
from hw.camera.camera import CameraError, Image
from hw.camera.v4l2_calls import FORMAT, STREAM_PARAMETERS, Device
from hw.camera.v4l2_controls import gone

YUYV, MJPG = (int.from_bytes(name, "little") for name in (b"YUYV", b"MJPG"))
ENCODINGS = (YUYV, MJPG)  # in this order: JPEG moves and flattens the focus peak
WANTED_HZ = 30
SLOWEST_NS = 66_700_000  # below 15 frames/s a full sweep takes 4 s; then JPEG is the smaller evil
UNKNOWN_NS = 1_000_000_000 // WANTED_HZ  # period of a driver that does not tell
END_OF_JPEG = b"\xff\xd9"


class Format(NamedTuple):
    size: tuple[int, int]  # width, height
    fourcc: int
    stride: int  # bytes from one row to the next, of YUYV
    period_ns: int  # between frames


def negotiate(device: Device, size: tuple[int, int] | None) -> Format:
    """The best format of `size`, by default the size that is set, or what comes nearest to it. Raises CameraError."""
    try:
        wanted = size or _current_size(device)
        offers = [offer for fourcc in ENCODINGS if (offer := _set(device, fourcc, wanted)).fourcc == fourcc]
        if not offers:
            raise CameraError(f"{device.path}: offers neither YUYV nor MJPG pictures; use another camera")
        best = min(offers, key=lambda o: (o.size != wanted, o.period_ns > SLOWEST_NS, o.fourcc != YUYV))
        return _set(device, best.fourcc, best.size)
    except OSError as error:
        if error.errno == errno.ENODEV:
            raise gone(device) from None
        why = "another program uses it" if error.errno == errno.EBUSY else error.strerror
        raise CameraError(f"{device.path}: its format cannot be set: {why}; see fuser and v4l2-ctl --all") from None


def decode(data: memoryview, form: Format) -> Image | None:
    """The picture in a buffer's filled part, (height, width, 3) blue green red; None if it is torn."""
    width, height = form.size
    if form.fourcc == MJPG:
        jpeg = bytes(data).rstrip(b"\0")  # some drivers pad
        if not jpeg.endswith(END_OF_JPEG) or stated_size(jpeg) != form.size:
            return None
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return None if image is None or image.shape != (height, width, 3) else np.asarray(image, np.uint8)
    if len(data) < form.stride * (height - 1) + 2 * width:
        return None
    rows = np.lib.stride_tricks.as_strided(np.frombuffer(data, np.uint8), (height, width, 2), (form.stride, 2, 1))
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(rows), cv2.COLOR_YUV2BGR_YUYV), np.uint8)


def _current_size(device: Device) -> tuple[int, int]:
    argument = bytearray(FORMAT.pack(v4l2.BUF_TYPE_VIDEO_CAPTURE, *12 * (0,)))
    device.ioctl(v4l2.G_FMT, argument)
    _, width, height, *_ = FORMAT.unpack(argument)
    return width, height


def _set(device: Device, fourcc: int, size: tuple[int, int]) -> Format:
    """Ask for a format; a driver takes the nearest that it has."""
    argument = bytearray(FORMAT.pack(v4l2.BUF_TYPE_VIDEO_CAPTURE, *size, fourcc, v4l2.FIELD_NONE, *8 * (0,)))
    device.ioctl(v4l2.S_FMT, argument)
    _, width, height, got, _, stride, *_ = FORMAT.unpack(argument)
    return Format((width, height), got, max(stride, 2 * width), _set_period_ns(device))


def _set_period_ns(device: Device) -> int:
    argument = bytearray(STREAM_PARAMETERS.pack(v4l2.BUF_TYPE_VIDEO_CAPTURE, 0, 0, 1, WANTED_HZ, 0, 0))
    try:
        device.ioctl(v4l2.S_PARM, argument)
    except OSError as error:
        if error.errno in (errno.EINVAL, errno.ENOTTY):
            return UNKNOWN_NS
        raise
    _, _, _, numerator, denominator, _, _ = STREAM_PARAMETERS.unpack(argument)
    return numerator * 1_000_000_000 // denominator if numerator and denominator else UNKNOWN_NS
