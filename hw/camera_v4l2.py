"""v4l2: a USB or CSI camera under Linux. Untested on hardware: checked against a fake of the driver's calls only.

OpenCV delivers the frames. The controls go to the driver directly, by number: OpenCV neither tells ranges nor leaves
values alone, and control names differ between kernels. Numbers and structs: linux/videodev2.h, linux/v4l2-controls.h.
"""

from __future__ import annotations

import errno
import fcntl
import os
import struct
import time
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import cv2

from hw.camera import CameraError, CameraGone, FocusRange, Frame, Image, Roi, deliverable, nearest

_QUERY = struct.Struct("=II32s4iI2I")  # struct v4l2_queryctrl: id type name min max step default flags reserved
_CONTROL = struct.Struct("=Ii")  # struct v4l2_control: id value
VIDIOC_QUERYCTRL = 0xC0445624  # _IOWR('V', 36, 68 bytes)
VIDIOC_G_CTRL = 0xC008561B  # _IOWR('V', 27, 8 bytes)
VIDIOC_S_CTRL = 0xC008561C  # _IOWR('V', 28, 8 bytes)

WHITE_BALANCE_AUTO, WHITE_BALANCE_K = 0x0098090C, 0x0098091A
GAIN_AUTO, GAIN = 0x00980912, 0x00980913
SHARPNESS = 0x0098091B
EXPOSURE_AUTO, EXPOSURE_100US = 0x009A0901, 0x009A0902
FOCUS_ABSOLUTE, FOCUS_AUTO = 0x009A090A, 0x009A090C
EXPOSURE_MANUAL = 1  # V4L2_EXPOSURE_MANUAL; 0 would be automatic
UNUSABLE = 0x0001 | 0x0004  # flags DISABLED, READ_ONLY

# automatic control, the value that switches it off, the value it governed: a sweep compares the sharpness of frames,
# so between them nothing but the lens may change
LOCKS = (
    (EXPOSURE_AUTO, EXPOSURE_MANUAL, EXPOSURE_100US),
    (GAIN_AUTO, 0, GAIN),
    (WHITE_BALANCE_AUTO, 0, WHITE_BALANCE_K),
)

WARM_UP_FRAMES = 20  # for the automatic exposure to come to rest before it is locked; 0.7 s at 30 frames/s

Ioctl = Callable[[int, bytearray], object]  # request, argument in and out; raises OSError


class Capture(Protocol):
    """What is used of cv2.VideoCapture."""

    def read(self) -> tuple[bool, Any]: ...
    def get(self, prop: int) -> float: ...
    def set(self, prop: int, value: float) -> bool: ...
    def release(self) -> None: ...


class Control(NamedTuple):
    lowest: int
    highest: int
    step: int


def open_v4l2(device: str, size: tuple[int, int] | None) -> V4l2Camera:
    """Open the device, ask for `size`, let the exposure settle and lock it. Raises CameraError."""
    try:
        descriptor = os.open(device, os.O_RDWR | os.O_NONBLOCK)
    except OSError as error:
        raise CameraError(f"{device}: cannot be opened: {error.strerror}; see v4l2-ctl --list-devices") from None
    capture = cv2.VideoCapture(device, cv2.CAP_V4L2)
    if not capture.isOpened():
        os.close(descriptor)
        raise CameraError(f"{device}: no pictures come from it; another program may hold it, or it is a metadata node")

    def ioctl(request: int, argument: bytearray) -> object:
        return fcntl.ioctl(descriptor, request, argument)

    camera = V4l2Camera(device, ioctl, capture, time.monotonic_ns, lambda: os.close(descriptor))
    try:
        camera.prepare(size)
    except CameraError:
        camera.close()
        raise
    return camera


class V4l2Camera:
    """Frames carry the driver's stamp, which UVC cameras take at the start of the exposure on CLOCK_MONOTONIC.

    A driver that falls silent holds read() for OpenCV's own limit of 10 s before CameraGone comes.
    """

    def __init__(
        self, device: str, ioctl: Ioctl, capture: Capture, clock_ns: Callable[[], int], closed: Callable[[], None]
    ) -> None:
        self.size = (0, 0)
        self._device = device
        self._ioctl = ioctl
        self._capture = capture
        self._clock_ns = clock_ns
        self._closed = closed
        self._focus: FocusRange | None = None
        self._focus_set_ns = 0
        self._half_exposure_ns = 0
        self._seq = 0

    def prepare(self, size: tuple[int, int] | None) -> None:
        """Choose format and size, then fix whatever the camera would change by itself."""
        self._capture.set(cv2.CAP_PROP_FOURCC, cv2.VideoWriter.fourcc(*"YUYV"))  # JPEG blurs the focus peak
        if size is not None:
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # a longer queue holds frames of earlier lens positions
        width, height = self._capture.get(cv2.CAP_PROP_FRAME_WIDTH), self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)
        self.size = (int(width), int(height))
        for _ in range(WARM_UP_FRAMES):
            self._grab()
        for automatic, off, value in LOCKS:
            self._lock(automatic, off, value)
        sharpness = self._query(SHARPNESS)
        if sharpness is not None:
            self._set(SHARPNESS, sharpness.lowest)  # sharpening in the camera shifts the focus peak
        if self._query(EXPOSURE_100US) is not None:
            self._half_exposure_ns = self._get(EXPOSURE_100US) * 100_000 // 2
        self._focus = self._prepare_focus()

    def focus_range(self) -> FocusRange | None:
        return self._focus

    def set_focus(self, position: int) -> int:
        if self._focus is None:
            raise CameraError(f"{self._device}: its focus cannot be set; use a camera with the control focus_absolute")
        self._set(FOCUS_ABSOLUTE, nearest(position, self._focus))
        self._focus_set_ns = self._clock_ns()
        return self._get(FOCUS_ABSOLUTE)  # a driver may clamp and still report success

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = 1.0) -> Frame:
        part = deliverable(roi, self.size)
        now_ns = self._clock_ns()
        not_before_ns = max(now_ns, self._focus_set_ns + round(settle_s * 1e9))
        while True:
            image, start_ns = self._grab()
            if start_ns >= not_before_ns:
                break
            if self._clock_ns() - now_ns > timeout_s * 1e9:
                raise CameraGone(
                    f"{self._device}: no new frame within {timeout_s} s; does its driver stamp by another clock?"
                )
        image = image[part.y : part.y + part.height, part.x : part.x + part.width].copy()
        return Frame(start_ns + self._half_exposure_ns, self._seq, image, part)

    def close(self) -> None:
        self._capture.release()
        self._closed()

    def _grab(self) -> tuple[Image, int]:
        """The next frame of the driver's queue and the start of its exposure, ns."""
        got, image = self._capture.read()
        if not got:
            raise CameraGone(f"{self._device}: no frame comes any more; was it unplugged?")
        self._seq += 1
        return image, round(self._capture.get(cv2.CAP_PROP_POS_MSEC) * 1e6)

    def _prepare_focus(self) -> FocusRange | None:
        # focus_absolute is inactive while the automatic is on, so that goes first
        if self._query(FOCUS_AUTO) is not None:
            self._set(FOCUS_AUTO, 0)
            if self._get(FOCUS_AUTO) != 0:
                raise CameraError(f"{self._device}: the autofocus cannot be switched off; use another camera")
        focus = self._query(FOCUS_ABSOLUTE)
        if focus is None or focus.highest <= focus.lowest:  # some drivers offer the control and no travel
            return None
        return FocusRange(focus.lowest, focus.highest, max(focus.step, 1))

    def _lock(self, automatic: int, off: int, value: int) -> None:
        """Switch an automatic off and keep the value at which it stood."""
        kept = self._get(value) if self._query(value) is not None else None
        if self._query(automatic) is not None:
            self._set(automatic, off)
            if self._get(automatic) != off:  # a driver may refuse and still report success
                raise CameraError(
                    f"{self._device}: control {automatic:#010x} cannot be switched off; use another camera"
                )
        if kept is not None:
            self._set(value, kept)

    def _query(self, control: int) -> Control | None:
        """None if the camera does not have the control."""
        argument = bytearray(_QUERY.pack(control, 0, b"", 0, 0, 0, 0, 0, 0, 0))
        try:
            self._ioctl(VIDIOC_QUERYCTRL, argument)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return None
            raise self._failed(error, control) from None
        _, _, _, lowest, highest, step, _, flags, _, _ = _QUERY.unpack(argument)
        return None if flags & UNUSABLE else Control(lowest, highest, step)

    def _get(self, control: int) -> int:
        argument = bytearray(_CONTROL.pack(control, 0))
        try:
            self._ioctl(VIDIOC_G_CTRL, argument)
        except OSError as error:
            raise self._failed(error, control) from None
        return int(_CONTROL.unpack(argument)[1])

    def _set(self, control: int, value: int) -> None:
        try:
            self._ioctl(VIDIOC_S_CTRL, bytearray(_CONTROL.pack(control, value)))
        except OSError as error:
            raise self._failed(error, control) from None

    def _failed(self, error: OSError, control: int) -> CameraError:
        if error.errno == errno.ENODEV:
            return CameraGone(f"{self._device}: went away; was it unplugged?")
        return CameraError(f"{self._device}: control {control:#010x}: {error.strerror}; look at it with v4l2-ctl -L")
