"""Frames out of a V4L2 driver's ring of buffers, each with the time at which it was exposed.

A driver without a free buffer drops the new frame, not the old: after a pause the ring holds frames of earlier lens
positions. They are told apart by the driver's own stamps, and handed back unread.
"""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Callable
from typing import NamedTuple

from hw.camera import v4l2_calls as v4l2
from hw.camera.camera import CameraError, CameraGone, Image
from hw.camera.v4l2_calls import BUFFER, BUFFER_TYPE, REQUEST_BUFFERS, Device
from hw.camera.v4l2_controls import gone
from hw.camera.v4l2_format import Format, decode

BUFFERS = 3  # one being filled, one to be filled next, one being read


class Exposure(NamedTuple):
    began_ns: int  # at the earliest, CLOCK_MONOTONIC
    middle_ns: int


class Picture(NamedTuple):
    number: int  # counts the frames of this stream
    image: Image
    middle_ns: int  # of the exposure


def clock_is_known(flags: int, stamp_ns: int, arrived_ns: int, period_ns: int) -> bool:
    """Whether a buffer's stamp is of CLOCK_MONOTONIC, as the driver says and as can be: others say nothing here."""
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
    """Started once with a format that is set, closed once. `exposure_ns` may be set at any time."""

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
        """Gives the buffers back, once; a device that is still mapped could not be opened by anybody."""
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
