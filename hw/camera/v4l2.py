"""v4l2: a USB or CSI camera under Linux. Untested on hardware: checked against a fake of the driver's calls only.

No library stands between this camera and the driver: only the driver's own stamps say which frame shows which lens
position, and only the driver tells the range of the focus.
"""

from __future__ import annotations

import contextlib
import errno
import logging
from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np

from agent.clock import machine
from agent.core.picture_head import stated_size
from hw.camera import v4l2_node as v4l2
from hw.camera.camera import PATIENCE_S, CameraError, CameraGone, FocusRange, Frame, Image, Roi, deliverable, nearest
from hw.camera.v4l2_node import (
    BUFFER,
    BUFFER_TYPE,
    FORMAT,
    LINUX,
    REQUEST_BUFFERS,
    STREAM_PARAMETERS,
    Controls,
    Device,
    System,
    find,
    free_focus,
    freeze,
    gone,
)

# --- format: size, encoding and frame rate ---

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


# --- stream: the driver's ring of buffers ---
#
# A driver without a free buffer drops the new frame, not the old: after a pause the ring holds frames of earlier lens
# positions. They are told apart by the driver's own stamps, and handed back unread.

BUFFERS = 3  # one being filled, one to be filled next, one being read


class Exposure(NamedTuple):
    began_ns: int  # at the earliest, CLOCK_MONOTONIC
    middle_ns: int


class Picture(NamedTuple):
    number: int  # counts the frames of this stream
    image: Image
    middle_ns: int  # of the exposure


def clock_is_known(flags: int, stamp_ns: int, arrived_ns: int, period_ns: int) -> bool:
    """Whether a stamp is of CLOCK_MONOTONIC: the driver says so, and it is at most a frame later than the arrival."""
    monotonic = flags & v4l2.BUF_FLAG_TIMESTAMP_MASK == v4l2.BUF_FLAG_TIMESTAMP_MONOTONIC
    return monotonic and stamp_ns <= arrived_ns + period_ns


def exposed(flags: int, stamp_ns: int, arrived_ns: int, exposure_ns: int, period_ns: int) -> Exposure:
    """When the frame of a buffer was exposed.

    UVC drivers stamp the start. Others stamp the end of the transfer, before which there were, at the earliest, the
    exposure and one period for reading the sensor out. A stamp of an unknown clock is replaced by the arrival.
    """
    known = clock_is_known(flags, stamp_ns, arrived_ns, period_ns)
    if known and flags & v4l2.BUF_FLAG_TSTAMP_SRC_MASK == v4l2.BUF_FLAG_TSTAMP_SRC_SOE:
        return Exposure(stamp_ns, stamp_ns + exposure_ns // 2)
    took_ns = exposure_ns + period_ns
    began_ns = (stamp_ns if known else arrived_ns) - took_ns
    return Exposure(began_ns, began_ns + took_ns // 2)


class Stream:
    """Frames of one device, each with the time at which it was exposed.

    Started once with a format that is set, closed once. `exposure_ns` may be set at any time.
    """

    def __init__(self, device: Device, form: Format, clock_ns: Callable[[], int]) -> None:
        self.exposure_ns = 0
        self.clock_known = True  # of the newest frame
        self._device, self._form, self._clock_ns = device, form, clock_ns
        self._buffers: list[memoryview] = []
        self._number = 0

    def start(self) -> None:
        """Raises CameraError where the driver has no buffers to give, as when another program reads from it."""
        try:
            argument = bytearray(REQUEST_BUFFERS.pack(BUFFERS, v4l2.BUF_TYPE_VIDEO_CAPTURE, v4l2.MEMORY_MMAP, 0))
            self._device.ioctl(v4l2.REQBUFS, argument)
            for index in range(REQUEST_BUFFERS.unpack(argument)[0]):
                *_, offset, length, _, _ = BUFFER.unpack(self._buffer_call(v4l2.QUERYBUF, index))
                self._buffers.append(self._device.map(offset, length))
                self._buffer_call(v4l2.QBUF, index)
            self._device.ioctl(v4l2.STREAMON, bytearray(BUFFER_TYPE.pack(v4l2.BUF_TYPE_VIDEO_CAPTURE)))
        except OSError as error:
            if error.errno == errno.ENODEV:
                raise gone(self._device) from None
            why = "another program reads from it" if error.errno == errno.EBUSY else error.strerror
            raise CameraError(f"{self._device.path}: no pictures: {why}; see fuser {self._device.path}") from None

    def next(self, not_before_ns: int, timeout_s: float) -> Picture:
        """The first whole frame whose exposure began at `not_before_ns` or later. Raises CameraGone."""
        until_ns = self._clock_ns() + round(timeout_s * 1e9)
        skipped = 0
        while (left_ns := until_ns - self._clock_ns()) > 0:
            if not self._device.wait(left_ns * 1e-9):
                continue
            filled = self._dequeue()
            if filled is None:
                continue
            index, count, flags, stamp_ns = filled
            arrived_ns, period_ns = self._clock_ns(), self._form.period_ns
            when = exposed(flags, stamp_ns, arrived_ns, self.exposure_ns, period_ns)
            self.clock_known = clock_is_known(flags, stamp_ns, arrived_ns, period_ns)
            self._number += 1
            usable = when.began_ns >= not_before_ns and not flags & v4l2.BUF_FLAG_ERROR
            image = decode(self._buffers[index][:count], self._form) if usable else None
            self._call(v4l2.QBUF, index)
            if image is not None:
                return Picture(self._number, image, when.middle_ns)
            skipped += 1
        why = "none at all" if not skipped else f"{skipped} were old or torn; does its driver stamp by another clock?"
        raise CameraGone(f"{self._device.path}: no new frame within {timeout_s:g} s: {why}")

    def close(self) -> None:
        """Gives the buffers back, once; a device that is still mapped could not be opened again."""
        if not self._buffers:
            return
        with contextlib.suppress(OSError):  # it may be gone
            self._device.ioctl(v4l2.STREAMOFF, bytearray(BUFFER_TYPE.pack(v4l2.BUF_TYPE_VIDEO_CAPTURE)))
        for view in self._buffers:
            view.release()
        self._buffers.clear()

    def _dequeue(self) -> tuple[int, int, int, int] | None:
        """Index, bytes, flags and stamp (ns) of the oldest filled buffer, None if there is none after all."""
        argument = self._call(v4l2.DQBUF, 0)
        if argument is None:
            return None
        index, _, count, flags, _, s, us, *_ = BUFFER.unpack(argument)
        return index, count, flags, (s * 1_000_000 + us) * 1000

    def _call(self, request: int, index: int) -> bytearray | None:
        try:
            return self._buffer_call(request, index)
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            if error.errno == errno.ENODEV:
                raise gone(self._device) from None
            raise CameraGone(f"{self._device.path}: its driver fails: {error.strerror}; opening it again") from None

    def _buffer_call(self, request: int, index: int) -> bytearray:
        fields = (index, v4l2.BUF_TYPE_VIDEO_CAPTURE, 0, 0, 0, 0, 0, b"", 0, v4l2.MEMORY_MMAP, 0, 0, 0, 0)
        argument = bytearray(BUFFER.pack(*fields))
        self._device.ioctl(request, argument)
        return argument


# --- camera ---

WARM_UP_FRAMES = 20  # for the automatic exposure to come to rest before it is locked; 0.7 s at 30 frames/s
FIRST_FRAME_S = 3.0  # limit while warming up; cameras need up to two seconds after they were plugged in

logger = logging.getLogger(__name__)


def open_v4l2(
    place: str, size: tuple[int, int] | None, system: System = LINUX, clock_ns: Callable[[], int] = machine.monotonic_ns
) -> V4l2Camera:
    """Open the camera at a path, or of a name or port; let its exposure settle and lock it.

    `size` is asked for, see `negotiate` for what comes. Raises CameraError, CameraGone if nothing is there now. What
    the camera lacks is said once, on the log.
    """
    device, who = find(place, system)
    stream: Stream | None = None
    try:
        form = negotiate(device, size)
        stream = Stream(device, form, clock_ns)
        stream.start()
        for _ in range(WARM_UP_FRAMES):
            stream.next(0, FIRST_FRAME_S)
        controls = Controls(device)
        missing = freeze(controls)
        focus = free_focus(controls)
        if controls.query(v4l2.EXPOSURE_ABSOLUTE) is not None:
            stream.exposure_ns = controls.get(v4l2.EXPOSURE_ABSOLUTE) * 100_000
    except CameraError:
        if stream is not None:
            stream.close()
        device.close()
        raise
    camera = V4l2Camera(device, controls, stream, form, focus, clock_ns)
    for line in shortcomings(missing, focus, form, stream.clock_known):
        logger.warning("%s ('%s'): %s", device.path, who.card, line)
    return camera


class V4l2Camera:
    """A camera that is set up. After CameraGone it has to be closed and opened again."""

    def __init__(
        self,
        device: Device,
        controls: Controls,
        stream: Stream,
        form: Format,
        focus: FocusRange | None,
        clock_ns: Callable[[], int],
    ) -> None:
        self.size = form.size
        self._device, self._controls, self._stream = device, controls, stream
        self._focus, self._clock_ns = focus, clock_ns
        self._focus_set_ns = 0

    def focus_range(self) -> FocusRange | None:
        return self._focus

    def set_focus(self, lens_position: int) -> int:
        if self._focus is None:
            raise CameraError(
                f"{self._device.path}: its focus cannot be set; use a camera with the control focus_absolute"
            )
        reported = self._controls.set(v4l2.FOCUS_ABSOLUTE, nearest(lens_position, self._focus))
        self._focus_set_ns = self._clock_ns()
        return reported

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        part = deliverable(roi, self.size)
        not_before_ns = max(self._clock_ns(), self._focus_set_ns + round(settle_s * 1e9))
        number, image, middle_ns = self._stream.next(not_before_ns, timeout_s)
        image = image[part.y : part.y + part.height, part.x : part.x + part.width].copy()
        return Frame(middle_ns, number, image, part)

    def close(self) -> None:
        self._stream.close()
        self._device.close()


def shortcomings(missing: list[str], focus: FocusRange | None, form: Format, clock_known: bool) -> list[str]:
    """What this camera cannot do that a good one can, a line each."""
    lines = []
    if missing:
        lines.append(f"it has no control of {', '.join(missing)}; what changes by itself in a sweep spoils its peak")
    if focus is None:
        lines.append("its focus cannot be set: distances come from the target's size alone")
    if form.fourcc == MJPG:
        lines.append("it delivers this size as JPEG only, or too slowly: the focus is found less exactly")
    if not clock_known:
        lines.append("its driver stamps frames by an unknown clock: their arrival counts, some milliseconds late")
    return lines
