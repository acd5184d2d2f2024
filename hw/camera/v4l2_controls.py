"""Controls of a V4L2 camera: what it has, what it is set to, and what keeps it from changing by itself.

Controls are addressed by number, since their names differ between kernels. A sweep compares the sharpness of frames,
so between them nothing but the lens may change.
"""

from __future__ import annotations

import errno
from typing import NamedTuple

from hw.camera import v4l2_calls as v4l2
from hw.camera.camera import CameraError, CameraGone, FocusRange
from hw.camera.v4l2_calls import CONTROL, QUERY_CONTROL, Device


class Control(NamedTuple):
    lowest: int
    highest: int
    step: int


class Lock(NamedTuple):
    """An automatic, the value that switches it off, and the control that it governed."""

    what: str
    automatic: int
    off: int
    governed: int


LOCKS = (
    Lock("exposure", v4l2.EXPOSURE_AUTO, v4l2.EXPOSURE_MANUAL, v4l2.EXPOSURE_ABSOLUTE),
    Lock("gain", v4l2.AUTOGAIN, 0, v4l2.GAIN),
    Lock("white balance", v4l2.AUTO_WHITE_BALANCE, 0, v4l2.WHITE_BALANCE_TEMPERATURE),
)

NAMES = {
    v4l2.EXPOSURE_AUTO: "the automatic exposure",
    v4l2.EXPOSURE_ABSOLUTE: "the exposure time",
    v4l2.EXPOSURE_AUTO_PRIORITY: "the frame rate that follows the light",
    v4l2.AUTOGAIN: "the automatic gain",
    v4l2.GAIN: "the gain",
    v4l2.AUTO_WHITE_BALANCE: "the automatic white balance",
    v4l2.WHITE_BALANCE_TEMPERATURE: "the white balance",
    v4l2.SHARPNESS: "the sharpness",
    v4l2.FOCUS_AUTO: "the autofocus",
    v4l2.FOCUS_ABSOLUTE: "the focus",
}


class Controls:
    """The controls of one device. Every method raises CameraGone if it went away, CameraError if it refuses."""

    def __init__(self, device: Device) -> None:
        self._device = device

    def query(self, control: int) -> Control | None:
        """Range of a control; None if the camera does not have it."""
        argument = bytearray(QUERY_CONTROL.pack(control, 0, b"", *7 * (0,)))
        try:
            self._device.ioctl(v4l2.QUERYCTRL, argument)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return None
            raise self._failed(error, control) from None
        _, _, _, lowest, highest, step, _, flags, _, _ = QUERY_CONTROL.unpack(argument)
        return None if flags & v4l2.UNUSABLE else Control(lowest, highest, step)

    def get(self, control: int) -> int:
        argument = bytearray(CONTROL.pack(control, 0))
        self._call(v4l2.G_CTRL, argument, control)
        return int(CONTROL.unpack(argument)[1])

    def set(self, control: int, value: int) -> int:
        """Returns the value read back: a driver may clamp, or do nothing, and still report success."""
        self._call(v4l2.S_CTRL, bytearray(CONTROL.pack(control, value)), control)
        return self.get(control)

    def lock(self, automatic: int, off: int, governed: int) -> bool:
        """Switch an automatic off and keep the value at which it stood; False if the camera has neither control."""
        has_automatic, has_governed = (self.query(control) is not None for control in (automatic, governed))
        kept = self.get(governed) if has_governed else 0
        if has_automatic:
            self.switch(automatic, off)
        if has_governed:
            self.set(governed, kept)
        return has_automatic or has_governed

    def switch(self, automatic: int, off: int) -> None:
        """Raises CameraError where the automatic stays on."""
        if self.set(automatic, off) != off:
            raise CameraError(
                f"{self._device.path}: {NAMES[automatic]} (control {automatic:#010x}) cannot be switched off; "
                "use another camera"
            )

    def _call(self, request: int, argument: bytearray, control: int) -> None:
        try:
            self._device.ioctl(request, argument)
        except OSError as error:
            raise self._failed(error, control) from None

    def _failed(self, error: OSError, control: int) -> CameraError:
        if error.errno == errno.ENODEV:
            return gone(self._device)
        return CameraError(
            f"{self._device.path}: {NAMES[control]} (control {control:#010x}): {error.strerror}; "
            "look at it with v4l2-ctl -L"
        )


def freeze(controls: Controls) -> list[str]:
    """Hold exposure, gain and white balance where their automatics left them; returns what the camera cannot hold."""
    missing = [lock.what for lock in LOCKS if not controls.lock(lock.automatic, lock.off, lock.governed)]
    if controls.query(v4l2.EXPOSURE_AUTO_PRIORITY) is not None:
        controls.set(v4l2.EXPOSURE_AUTO_PRIORITY, 0)
    sharpness = controls.query(v4l2.SHARPNESS)
    if sharpness is None:
        return [*missing, "sharpening"]
    controls.set(v4l2.SHARPNESS, sharpness.lowest)  # sharpening in the camera shifts the focus peak
    return missing


def free_focus(controls: Controls) -> FocusRange | None:
    """Switch the autofocus off, since the focus cannot be set while it is on; the lens's range, None if it has none."""
    if controls.query(v4l2.FOCUS_AUTO) is not None:
        controls.switch(v4l2.FOCUS_AUTO, 0)
    focus = controls.query(v4l2.FOCUS_ABSOLUTE)
    if focus is None or focus.highest <= focus.lowest:  # some drivers offer the control and no travel
        return None
    return FocusRange(focus.lowest, focus.highest, max(focus.step, 1))


def gone(device: Device) -> CameraGone:
    return CameraGone(
        f"{device.path}: went away; was it unplugged? It may come back under another number: name it by what it is, "
        "v4l2:CARD, v4l2:BUS or a link in /dev/v4l/by-id"
    )
