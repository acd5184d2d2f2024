"""Video4Linux below the frames: the driver's calls, the video nodes of this computer, and a camera's controls."""

from __future__ import annotations

import errno
import fcntl
import mmap
import os
import re
import select
import struct
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple, Protocol

from hw.camera.camera import CameraError, CameraGone, FocusRange

# --- driver calls ---
#
# Numbers and structs of linux/videodev2.h and linux/v4l2-controls.h, by their names there without V4L2_ and CID_.
# Structs are in the machine's own layout (struct's "@"), as the kernel reads them.

CAPABILITY = struct.Struct("@16s32s32s3I12x")  # driver card bus_info version capabilities device_caps
FORMAT = struct.Struct("@I0L12I152x")  # type; width height fourcc field bytesperline sizeimage colorspace priv flags 3*
STREAM_PARAMETERS = struct.Struct("@7I176x")  # type capability mode, period: numerator denominator, mode buffers
REQUEST_BUFFERS = struct.Struct("@4I4x")  # count type memory capabilities
BUFFER = struct.Struct("@5I2l16s2IL3I0L")  # index type bytes flags field, s us, timecode, seq memory offset length 2*
BUFFER_TYPE = struct.Struct("@I")
QUERY_CONTROL = struct.Struct("@2I32s4i3I")  # id type name lowest highest step default flags reserved 2*
CONTROL = struct.Struct("@Ii")  # id value


def _request_code(way: int, nr: int, layout: struct.Struct) -> int:
    """_IOC of asm-generic/ioctl.h: direction, size of the argument, type 'V', number."""
    return way << 30 | layout.size << 16 | ord("V") << 8 | nr


_WRITE, _READ, _BOTH = 1, 2, 3
QUERYCAP = _request_code(_READ, 0, CAPABILITY)
G_FMT, S_FMT = _request_code(_BOTH, 4, FORMAT), _request_code(_BOTH, 5, FORMAT)
REQBUFS = _request_code(_BOTH, 8, REQUEST_BUFFERS)
QUERYBUF, QBUF, DQBUF = (_request_code(_BOTH, nr, BUFFER) for nr in (9, 15, 17))
STREAMON, STREAMOFF = (_request_code(_WRITE, nr, BUFFER_TYPE) for nr in (18, 19))
S_PARM = _request_code(_BOTH, 22, STREAM_PARAMETERS)
G_CTRL, S_CTRL = _request_code(_BOTH, 27, CONTROL), _request_code(_BOTH, 28, CONTROL)
QUERYCTRL = _request_code(_BOTH, 36, QUERY_CONTROL)

CAP_VIDEO_CAPTURE, CAP_STREAMING, CAP_DEVICE_CAPS = 0x1, 0x0400_0000, 0x8000_0000  # capabilities
BUF_TYPE_VIDEO_CAPTURE = 1
MEMORY_MMAP = 1
FIELD_NONE = 1  # progressive

# flags of a buffer
BUF_FLAG_ERROR = 0x40  # the bytes may be wrong, the next buffer will be right again
BUF_FLAG_TIMESTAMP_MASK, BUF_FLAG_TIMESTAMP_MONOTONIC = 0xE000, 0x2000  # else unknown, or copied from elsewhere
BUF_FLAG_TSTAMP_SRC_MASK = 0x7_0000
BUF_FLAG_TSTAMP_SRC_SOE = 0x1_0000  # stamped at the start of the exposure; else when the last byte had come

# flags of a control
UNUSABLE = 0x0001 | 0x0004  # DISABLED, READ_ONLY

AUTO_WHITE_BALANCE, WHITE_BALANCE_TEMPERATURE = 0x0098_090C, 0x0098_091A  # the latter in kelvin
AUTOGAIN, GAIN = 0x0098_0912, 0x0098_0913
SHARPNESS = 0x0098_091B
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE = 0x009A_0901, 0x009A_0902  # the latter in units of 100 us
EXPOSURE_AUTO_PRIORITY = 0x009A_0903  # the exposure may slow the frames down
FOCUS_ABSOLUTE, FOCUS_AUTO = 0x009A_090A, 0x009A_090C
EXPOSURE_MANUAL = 1  # 0 would be automatic


class Device(Protocol):
    """One open video node: a `Node`, or a fake of the driver's calls."""

    path: str

    def ioctl(self, request: int, argument: bytearray) -> None:
        """One request; its argument is a struct that the driver reads and writes. Raises OSError."""

    def map(self, offset: int, length: int) -> memoryview:
        """The memory of one of the driver's buffers."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until a buffer is filled, or the device has something else to say; False if nothing came in time."""

    def close(self) -> None: ...


class Identity(NamedTuple):
    """What a camera says of itself."""

    card: str  # its name
    bus: str  # the port that it is plugged into
    captures: bool  # delivers pictures; a webcam's second node delivers only what is known about them


def identity(device: Device) -> Identity:
    """Raises OSError, ENOTTY for a node that is no Video4Linux device."""
    argument = bytearray(CAPABILITY.size)
    device.ioctl(QUERYCAP, argument)
    _, card, bus, _, whole, node = CAPABILITY.unpack(argument)
    can = node if whole & CAP_DEVICE_CAPS else whole
    return Identity(_text(card), _text(bus), can & CAP_VIDEO_CAPTURE != 0 and can & CAP_STREAMING != 0)


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode(errors="replace")


# --- video nodes ---
#
# A camera that is unplugged and plugged in again may come back under another number. Its name, the port that it is
# plugged into, and udev's links under /dev/v4l/by-id stay the same.


class Node:
    """The `Device` of a path under /dev."""

    def __init__(self, path: str, descriptor: int) -> None:
        self.path = path
        self._descriptor = descriptor
        self._poll = select.poll()
        self._poll.register(descriptor, select.POLLIN)

    def ioctl(self, request: int, argument: bytearray) -> None:
        fcntl.ioctl(self._descriptor, request, argument)

    def map(self, offset: int, length: int) -> memoryview:
        return memoryview(mmap.mmap(self._descriptor, length, offset=offset))

    def wait(self, timeout_s: float) -> bool:
        return bool(self._poll.poll(1e3 * max(timeout_s, 0.0)))

    def close(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1


class System(NamedTuple):
    """Where cameras are looked for; tests have one of their own."""

    nodes: Callable[[], Iterable[str]]  # paths, in the order of their numbers
    attach: Callable[[str], Device]  # raises OSError


def _nodes() -> list[str]:
    numbered = [
        (int(found[1]), str(path)) for path in Path("/dev").glob("video*") if (found := _NODE_NUMBER(path.name))
    ]
    return [path for _, path in sorted(numbered)]


_NODE_NUMBER = re.compile(r"video(\d+)").fullmatch


def _attach(path: str) -> Node:
    return Node(path, os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC))


LINUX = System(_nodes, _attach)


def find(place: str, system: System = LINUX) -> tuple[Device, Identity]:
    """Open the camera at a path, or else the one whose name or port is `place`. The caller closes it.

    Raises CameraGone if it is not there now, CameraError if what is there is no camera, or two have the name.
    """
    return _at_path(place, system) if place.startswith("/") else _by_name(place, system)


def _at_path(path: str, system: System) -> tuple[Device, Identity]:
    device = _opened(path, system)
    try:
        who = identity(device)
        if who.captures:
            return device, who
        why = f"'{who.card}' gives no pictures here; its other nodes may"
    except OSError as error:
        why = f"not a video device ({error.strerror})"
    device.close()
    raise CameraError(f"{path}: {why}; see v4l2-ctl --list-devices")


def _opened(path: str, system: System) -> Device:
    try:
        return system.attach(path)
    except PermissionError:
        raise CameraError(f"{path}: you may not open it; join its group, video on most systems") from None
    except OSError as error:
        raise CameraGone(f"{path}: cannot be opened: {error.strerror}; see v4l2-ctl --list-devices") from None


def _by_name(name: str, system: System) -> tuple[Device, Identity]:
    found: list[tuple[Device, Identity]] = []
    there: list[str] = []  # what could not be it
    for path in system.nodes():
        try:
            device = _opened(path, system)
        except CameraGone:
            continue
        except CameraError as error:
            there.append(str(error))
            continue
        try:
            who = identity(device)
        except OSError:  # not a video device, whatever its name
            who = Identity("", "", captures=False)
        if who.captures and name in (who.card, who.bus):
            found.append((device, who))
            continue
        device.close()
        if who.captures:
            there.append(f"'{who.card}' at {who.bus}")
    if len(found) == 1:
        return found[0]
    for device, _ in found:
        device.close()
    if found:
        ports = " or ".join(f"v4l2:{who.bus}" for _, who in found)
        raise CameraError(f"{len(found)} cameras are called '{name}'; name one by its port: {ports}")
    raise CameraGone(f"no camera is called '{name}'; there is {', '.join(there) or 'none at all'}")


# --- controls ---
#
# Controls are addressed by number, since their names differ between kernels. A sweep compares the sharpness of
# frames, so between them nothing but the lens may change.


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
    Lock("exposure", EXPOSURE_AUTO, EXPOSURE_MANUAL, EXPOSURE_ABSOLUTE),
    Lock("gain", AUTOGAIN, 0, GAIN),
    Lock("white balance", AUTO_WHITE_BALANCE, 0, WHITE_BALANCE_TEMPERATURE),
)

NAMES = {
    EXPOSURE_AUTO: "the automatic exposure",
    EXPOSURE_ABSOLUTE: "the exposure time",
    EXPOSURE_AUTO_PRIORITY: "the frame rate that follows the light",
    AUTOGAIN: "the automatic gain",
    GAIN: "the gain",
    AUTO_WHITE_BALANCE: "the automatic white balance",
    WHITE_BALANCE_TEMPERATURE: "the white balance",
    SHARPNESS: "the sharpness",
    FOCUS_AUTO: "the autofocus",
    FOCUS_ABSOLUTE: "the focus",
}


class Controls:
    """The controls of one device. Every method raises CameraGone if it went away, CameraError if it refuses."""

    def __init__(self, device: Device) -> None:
        self._device = device

    def query(self, control: int) -> Control | None:
        """Range of a control; None if the camera does not have it."""
        argument = bytearray(QUERY_CONTROL.pack(control, 0, b"", *7 * (0,)))
        try:
            self._device.ioctl(QUERYCTRL, argument)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return None
            raise self._failed(error, control) from None
        _, _, _, lowest, highest, step, _, flags, _, _ = QUERY_CONTROL.unpack(argument)
        return None if flags & UNUSABLE else Control(lowest, highest, step)

    def get(self, control: int) -> int:
        argument = bytearray(CONTROL.pack(control, 0))
        self._call(G_CTRL, argument, control)
        return int(CONTROL.unpack(argument)[1])

    def set(self, control: int, value: int) -> int:
        """Returns the value read back: a driver may clamp, or do nothing, and still report success."""
        self._call(S_CTRL, bytearray(CONTROL.pack(control, value)), control)
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
    if controls.query(EXPOSURE_AUTO_PRIORITY) is not None:
        controls.set(EXPOSURE_AUTO_PRIORITY, 0)
    sharpness = controls.query(SHARPNESS)
    if sharpness is None:
        return [*missing, "sharpening"]
    controls.set(SHARPNESS, sharpness.lowest)  # sharpening in the camera shifts the focus peak
    return missing


def free_focus(controls: Controls) -> FocusRange | None:
    """Switch the autofocus off, since the focus cannot be set while it is on; the lens's range, None if it has none."""
    if controls.query(FOCUS_AUTO) is not None:
        controls.switch(FOCUS_AUTO, 0)
    focus = controls.query(FOCUS_ABSOLUTE)
    if focus is None or focus.highest <= focus.lowest:  # some drivers offer the control and no travel
        return None
    return FocusRange(focus.lowest, focus.highest, max(focus.step, 1))


def gone(device: Device) -> CameraGone:
    return CameraGone(
        f"{device.path}: went away; was it unplugged? It may come back under another number: name it by what it is, "
        "v4l2:CARD, v4l2:BUS or a link in /dev/v4l/by-id"
    )
