"""Video4Linux below the frames: the driver's calls, the video nodes of this computer, and a camera's controls."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import mmap
import os
import re
import select
import struct
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from agent.core.config import MainsHz
from hw.camera.camera import CameraError, CameraGone, FocusRange, no_control

# --- driver calls ---
#
# Numbers and structs of linux/videodev2.h and linux/v4l2-controls.h, by their names there without V4L2_ and CID_.
# Structs are in the machine's own layout (struct's "@"), as the kernel reads them.

CAPABILITY = struct.Struct("@16s32s32s3I12x")  # driver card bus_info version capabilities device_caps
# type; width height fourcc field, then bytesperline sizeimage colorspace ..., or of planes colorspace sizeimage
# bytesperline ...
FORMAT = struct.Struct("@I0L12I152x")
FORMAT_OFFER = struct.Struct("@3I32sI16x")  # index type flags description fourcc
SIZE_OFFER = struct.Struct("@9I8x")  # index fourcc type, width height or of a range width 3* height 3*
RATE_OFFER = struct.Struct("@7I24x")  # index fourcc width height type, period: numerator denominator
STREAM_PARAMETERS = struct.Struct("@7I176x")  # type capability mode, period: numerator denominator, mode buffers
REQUEST_BUFFERS = struct.Struct("@4I4x")  # count type memory capabilities
BUFFER = struct.Struct("@5I2l16s2IL3I0L")  # index type bytes flags field, s us, timecode, seq memory offset length 2*
PLANE = struct.Struct("@2ILI44x")  # bytes length offset begins
BUFFER_TYPE = struct.Struct("@I")
QUERY_CONTROL = struct.Struct("@2I32s4i3I")  # id type name lowest highest step default flags reserved 2*
QUERY_MENU = struct.Struct("=2I32sI")  # id index name reserved
CONTROL = struct.Struct("@Ii")  # id value


def _request_code(way: int, nr: int, layout: struct.Struct) -> int:
    """_IOC of asm-generic/ioctl.h: direction, size of the argument, type 'V', number."""
    return way << 30 | layout.size << 16 | ord("V") << 8 | nr


_WRITE, _READ, _BOTH = 1, 2, 3
QUERYCAP = _request_code(_READ, 0, CAPABILITY)
ENUM_FMT = _request_code(_BOTH, 2, FORMAT_OFFER)
G_FMT, S_FMT = _request_code(_BOTH, 4, FORMAT), _request_code(_BOTH, 5, FORMAT)
REQBUFS = _request_code(_BOTH, 8, REQUEST_BUFFERS)
QUERYBUF, QBUF, DQBUF = (_request_code(_BOTH, nr, BUFFER) for nr in (9, 15, 17))
STREAMON, STREAMOFF = (_request_code(_WRITE, nr, BUFFER_TYPE) for nr in (18, 19))
S_PARM = _request_code(_BOTH, 22, STREAM_PARAMETERS)
G_CTRL, S_CTRL = _request_code(_BOTH, 27, CONTROL), _request_code(_BOTH, 28, CONTROL)
QUERYCTRL, QUERYMENU = _request_code(_BOTH, 36, QUERY_CONTROL), _request_code(_BOTH, 37, QUERY_MENU)
ENUM_FRAMESIZES, ENUM_FRAMEINTERVALS = _request_code(_BOTH, 74, SIZE_OFFER), _request_code(_BOTH, 75, RATE_OFFER)

CAP_VIDEO_CAPTURE, CAP_VIDEO_CAPTURE_MPLANE = 0x1, 0x1000  # capabilities
CAP_STREAMING, CAP_DEVICE_CAPS = 0x0400_0000, 0x8000_0000
BUF_TYPE_VIDEO_CAPTURE, BUF_TYPE_VIDEO_CAPTURE_MPLANE = 1, 9
MEMORY_MMAP = 1
FIELD_NONE = 1  # progressive

# flags of a buffer
BUF_FLAG_ERROR = 0x40  # the bytes may be wrong, the next buffer will be right again
BUF_FLAG_TIMESTAMP_MASK, BUF_FLAG_TIMESTAMP_MONOTONIC = 0xE000, 0x2000  # else unknown, or copied from elsewhere
BUF_FLAG_TSTAMP_SRC_MASK = 0x7_0000
BUF_FLAG_TSTAMP_SRC_SOE = 0x1_0000  # stamped at the start of the exposure, it says; else when the last byte had come

FMT_FLAG_COMPRESSED = 0x0001  # flag of a format
DISCRETE = 1  # type of a size that is one of a list; else they are a range

# flags of a control
UNUSABLE = 0x0001 | 0x0004  # DISABLED, READ_ONLY

AUTO_WHITE_BALANCE, WHITE_BALANCE_TEMPERATURE = 0x0098_090C, 0x0098_091A  # the latter in kelvin
AUTOGAIN, GAIN = 0x0098_0912, 0x0098_0913
POWER_LINE_FREQUENCY = 0x0098_0918
SHARPNESS = 0x0098_091B
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE = 0x009A_0901, 0x009A_0902  # the latter in units of 100 us
EXPOSURE_AUTO_PRIORITY = 0x009A_0903  # the exposure may slow the frames down
FOCUS_ABSOLUTE, FOCUS_AUTO = 0x009A_090A, 0x009A_090C
EXPOSURE_MANUAL = 1  # entries of EXPOSURE_AUTO
EXPOSURE_SHUTTER_PRIORITY = 2  # the exposure time stays, an iris may move; webcams have none
EXPOSURE_HELD = (EXPOSURE_MANUAL, EXPOSURE_SHUTTER_PRIORITY)  # the best first
MAINS: dict[MainsHz, int] = {50: 1, 60: 2}  # Hz -> entry of POWER_LINE_FREQUENCY


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

    driver: str
    card: str  # its name
    bus: str  # the port that it is plugged into
    buffers: int  # BUF_TYPE of its pictures; 0: none, as of a webcam's second node, which tells what is known of them

    @property
    def captures(self) -> bool:
        return self.buffers != 0


def identity(device: Device) -> Identity:
    """Raises OSError, ENOTTY for a node that is no Video4Linux device."""
    argument = bytearray(CAPABILITY.size)
    device.ioctl(QUERYCAP, argument)
    driver, card, bus, _, whole, node = CAPABILITY.unpack(argument)
    can = node if whole & CAP_DEVICE_CAPS else whole
    buffers = BUF_TYPE_VIDEO_CAPTURE_MPLANE if can & CAP_VIDEO_CAPTURE_MPLANE else 0
    buffers = BUF_TYPE_VIDEO_CAPTURE if can & CAP_VIDEO_CAPTURE else buffers
    return Identity(_text(driver), _text(card), _text(bus), buffers if can & CAP_STREAMING else 0)


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode(errors="replace")


class Buffer(NamedTuple):
    """One of the driver's buffers, as it answers a call about it."""

    number: int
    filled: int  # bytes
    flags: int
    stamp_ns: int
    offset: int  # in the node, to map it
    length: int  # bytes


def buffer_call(device: Device, request: int, buffers: int, number: int) -> Buffer:
    """QUERYBUF, QBUF or DQBUF of a queue of BUF_TYPE `buffers`. Raises OSError.

    Formats that we take lie in one plane, so that a multi-planar queue differs by where the driver writes its length.
    """
    plane = (ctypes.c_char * PLANE.size)()
    planes = (ctypes.addressof(plane), 1) if buffers == BUF_TYPE_VIDEO_CAPTURE_MPLANE else (0, 0)
    argument = bytearray(BUFFER.pack(number, buffers, 0, 0, 0, 0, 0, b"", 0, MEMORY_MMAP, *planes, 0, 0))
    device.ioctl(request, argument)
    number, _, filled, flags, _, s, us, _, _, _, offset, length, _, _ = BUFFER.unpack(argument)
    if buffers == BUF_TYPE_VIDEO_CAPTURE_MPLANE:
        filled, length, offset, _ = PLANE.unpack(bytes(plane))
    return Buffer(number, filled, flags, (s * 1_000_000 + us) * 1000, offset, length)


# --- formats ---

YUYV, UYVY, NV12, MJPG = (int.from_bytes(name, "little") for name in (b"YUYV", b"UYVY", b"NV12", b"MJPG"))
ENCODINGS = (YUYV, UYVY, NV12, MJPG)  # that are read, the best first: JPEG moves and flattens the focus peak


class FormatOffer(NamedTuple):
    fourcc: int
    compressed: bool
    description: str  # in the kernel's words


def format_offers(device: Device, buffers: int) -> list[FormatOffer]:
    """All formats of a node; none where its driver does not list them. Raises OSError if it went away."""
    return [
        FormatOffer(fourcc, flags & FMT_FLAG_COMPRESSED != 0, _text(description))
        for _, _, flags, description, fourcc in _listed(device, ENUM_FMT, FORMAT_OFFER, buffers, 0, b"", 0)
    ]


def size_offers(device: Device, fourcc: int) -> list[tuple[int, int]]:
    """Width and height, pixels, of what a format comes in; of a range its smallest alone. Raises OSError."""
    sizes = _listed(device, ENUM_FRAMESIZES, SIZE_OFFER, fourcc, *7 * (0,))
    return [(width, height if kind == DISCRETE else lowest) for _, _, kind, width, height, _, lowest, *_ in sizes]


def rate_offer(device: Device, fourcc: int, size: tuple[int, int]) -> float:
    """The highest frame rate of a size, Hz; 0 where the driver does not tell. Raises OSError."""
    rates = _listed(device, ENUM_FRAMEINTERVALS, RATE_OFFER, fourcc, *size, 0, 0, 0)
    return max((denominator / numerator for *_, numerator, denominator in rates if numerator), default=0.0)


def _listed(device: Device, request: int, layout: struct.Struct, *asked: int | bytes) -> Iterator[tuple[Any, ...]]:
    """The entries of one of the driver's lists, whose index is the first field."""
    for index in range(MOST_ENTRIES):
        argument = bytearray(layout.pack(index, *asked))
        try:
            device.ioctl(request, argument)
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return
            raise
        yield layout.unpack(argument)


MOST_ENTRIES = 64  # of a list; drivers with a range answer the first index alone


def name_of(fourcc: int) -> str:
    return fourcc.to_bytes(4, "little").decode("ascii", errors="replace").strip()


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
    hardware_stamps: Callable[[], bool]  # whether uvcvideo stamps by the camera's clock, not by the arrival


def _nodes() -> list[str]:
    numbered = [
        (int(found[1]), str(path)) for path in Path("/dev").glob("video*") if (found := _NODE_NUMBER(path.name))
    ]
    return [path for _, path in sorted(numbered)]


_NODE_NUMBER = re.compile(r"video(\d+)").fullmatch


def _attach(path: str) -> Node:
    return Node(path, os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC))


def _hardware_stamps() -> bool:
    try:
        return HARDWARE_STAMPS.read_text().strip() not in ("", "0", "N")
    except OSError:  # there is no such driver
        return False


HARDWARE_STAMPS = Path("/sys/module/uvcvideo/parameters/hwtimestamps")
LINUX = System(_nodes, _attach, _hardware_stamps)


def find(place: str, system: System = LINUX) -> tuple[Device, Identity]:
    """Open the camera at a path, or else the one whose name or port is `place`. The caller closes it.

    Raises CameraGone if it is not there now, CameraError if what is there is no camera, or two have the name.
    """
    return _at_path(place, system) if place.startswith("/") else _by_name(place, system)


def _at_path(path: str, system: System) -> tuple[Device, Identity]:
    device = opened(path, system)
    try:
        who = identity(device)
        if who.captures:
            return device, who
        why = f"'{who.card}' gives no pictures here; its other nodes may"
    except OSError as error:
        why = f"not a video device ({error.strerror})"
    device.close()
    raise CameraError(f"{path}: {why}; see v4l2-ctl --list-devices")


def opened(path: str, system: System) -> Device:
    """Raises CameraError where we may not, CameraGone where nothing is."""
    try:
        return system.attach(path)
    except OSError as error:
        if error.errno == errno.EACCES:
            raise CameraError(f"{path}: you may not open it; join its group, video on most systems") from None
        raise CameraGone(f"{path}: cannot be opened: {error.strerror}; see v4l2-ctl --list-devices") from None


def _by_name(name: str, system: System) -> tuple[Device, Identity]:
    found: list[tuple[Device, Identity]] = []
    there: list[str] = []  # what could not be it
    for path in system.nodes():
        try:
            device = opened(path, system)
        except CameraGone:
            continue
        except CameraError as error:
            there.append(str(error))
            continue
        try:
            who = identity(device)
        except OSError:  # not a video device, whatever its name
            who = Identity("", "", "", 0)
        if who.captures and name in (who.card, who.bus):
            found.append((device, who))
            continue
        device.close()
        if who.captures:
            there.append(f"'{who.card}' at {who.bus}")
    read = found if len(found) < 2 else [one for one in found if useful(*one)]
    for device, _ in found:
        if len(read) != 1 or device is not read[0][0]:
            device.close()
    if len(read) == 1:
        return read[0]
    if found:
        ports = " or ".join(f"v4l2:{who.bus}" for _, who in found)
        raise CameraError(f"{len(found)} cameras are called '{name}'; name one by its port: {ports}")
    raise CameraGone(f"no camera is called '{name}'; there is {', '.join(there) or 'none at all'}")


def useful(device: Device, who: Identity) -> bool:
    """Whether we read one of its formats: a webcam may have a node of H.264 beside that of its pictures."""
    try:
        return any(offer.fourcc in ENCODINGS for offer in format_offers(device, who.buffers))
    except OSError:
        return False


# --- controls ---
#
# Controls are addressed by number, since their names differ between kernels. A sweep compares the sharpness of
# frames, so between them nothing but the lens may change.


class Control(NamedTuple):
    lowest: int
    highest: int
    step: int


class Lock(NamedTuple):
    """An automatic, the entries that switch it off, the best first, and the control that it governed."""

    what: str
    automatic: int
    off: tuple[int, ...]
    governed: int


LOCKS = (
    Lock("exposure", EXPOSURE_AUTO, EXPOSURE_HELD, EXPOSURE_ABSOLUTE),
    Lock("gain", AUTOGAIN, (0,), GAIN),
    Lock("white balance", AUTO_WHITE_BALANCE, (0,), WHITE_BALANCE_TEMPERATURE),
)

NAMES = {
    EXPOSURE_AUTO: "the automatic exposure",
    EXPOSURE_ABSOLUTE: "the exposure time",
    EXPOSURE_AUTO_PRIORITY: "the frame rate that follows the light",
    AUTOGAIN: "the automatic gain",
    GAIN: "the gain",
    AUTO_WHITE_BALANCE: "the automatic white balance",
    WHITE_BALANCE_TEMPERATURE: "the white balance",
    POWER_LINE_FREQUENCY: "the filter of mains flicker",
    SHARPNESS: "the sharpness",
    FOCUS_AUTO: "the autofocus",
    FOCUS_ABSOLUTE: "the focus",
}


class ControlFailed(CameraError):
    """One control does not do what it is for; `why` names it, without the device."""

    def __init__(self, device: Device, control: int, why: str) -> None:
        self.why = f"{NAMES[control]} (control {control:#010x}) {why}"
        super().__init__(f"{device.path}: {self.why}")


class Controls:
    """The controls of one device. Every method raises CameraGone if it went away, ControlFailed if it refuses."""

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

    def entries(self, control: int, known: Control) -> dict[int, str]:
        """The menu of a control: a driver leaves out what its camera cannot do. Empty if it has no menu."""
        found: dict[int, str] = {}
        for index in range(known.lowest, known.highest + 1):
            argument = bytearray(QUERY_MENU.pack(control, index, b"", 0))
            with contextlib.suppress(OSError):  # it has no such entry
                self._device.ioctl(QUERYMENU, argument)
                found[index] = _text(QUERY_MENU.unpack(argument)[2])
        return found

    def get(self, control: int) -> int:
        argument = bytearray(CONTROL.pack(control, 0))
        self._call(G_CTRL, argument, control)
        return int(CONTROL.unpack(argument)[1])

    def set(self, control: int, value: int) -> int:
        """Returns the value read back: a driver may clamp, or do nothing, and still report success."""
        self._call(S_CTRL, bytearray(CONTROL.pack(control, value)), control)
        return self.get(control)

    def insist(self, control: int, value: int, otherwise: str) -> None:
        """Raises ControlFailed, which says `otherwise`, where the driver keeps another value."""
        if self.set(control, value) != value:
            raise ControlFailed(self._device, control, otherwise)

    def lock(self, lock: Lock) -> bool:
        """Switch an automatic off and keep the value at which it stood; False if the camera has neither control.

        Raises ControlFailed also where the automatic stays on.
        """
        automatic, governed = self.query(lock.automatic), self.query(lock.governed)
        kept = None if governed is None else self.get(lock.governed)
        if automatic is not None:
            self._switch_off(lock, automatic)
        if kept is not None:
            self.set(lock.governed, kept)
        return automatic is not None or governed is not None

    def _switch_off(self, lock: Lock, automatic: Control) -> None:
        menu = self.entries(lock.automatic, automatic) if len(lock.off) > 1 else {}
        off = next((entry for entry in lock.off if not menu or entry in menu), None)
        if off is None:
            raise ControlFailed(
                self._device, lock.automatic, f"cannot be held, it has only: {', '.join(menu.values())}"
            )
        self.insist(lock.automatic, off, "cannot be switched off")

    def _call(self, request: int, argument: bytearray, control: int) -> None:
        try:
            self._device.ioctl(request, argument)
        except OSError as error:
            raise self._failed(error, control) from None

    def _failed(self, error: OSError, control: int) -> CameraError:
        if error.errno == errno.ENODEV:
            return gone(self._device)
        return ControlFailed(self._device, control, f"fails: {error.strerror}; look at it with v4l2-ctl -L")


@contextlib.contextmanager
def said(lines: list[str]) -> Iterator[None]:
    """A control that fails in the block is a line more, and no end."""
    try:
        yield
    except ControlFailed as failed:
        lines.append(failed.why)


def freeze(controls: Controls, mains_hz: MainsHz) -> list[str]:
    """Hold exposure, gain and white balance where their automatics left them, and filter the flicker of lamps.

    mains_hz: 50 or 60, of the country. Returns a line for all that the camera has no control of, and one for each
    control that fails.
    """
    missing: list[str] = []
    lines: list[str] = []
    for lock in LOCKS:
        with said(lines):
            if not controls.lock(lock):
                missing.append(lock.what)
    with said(lines):
        if controls.query(EXPOSURE_AUTO_PRIORITY) is not None:
            controls.set(EXPOSURE_AUTO_PRIORITY, 0)
    with said(lines):
        if controls.query(POWER_LINE_FREQUENCY) is not None:
            controls.insist(POWER_LINE_FREQUENCY, MAINS[mains_hz], f"cannot be set to {mains_hz} Hz")
    with said(lines):
        sharpness = controls.query(SHARPNESS)
        if sharpness is None:
            missing.append("sharpening")
        else:
            controls.set(SHARPNESS, sharpness.lowest)  # sharpening in the camera shifts the focus peak
    if missing:
        lines.insert(0, no_control(missing))
    return lines


def free_focus(controls: Controls, path: str) -> tuple[FocusRange | None, list[str]]:
    """Switch the autofocus off, since the focus cannot be set while it is on; the lens's range, None if it has none,
    and a line for each control that fails. Raises CameraError where the autofocus stays on: the lens would move by
    itself."""
    lines: list[str] = []
    focus: Control | None = None
    with said(lines):
        if controls.query(FOCUS_AUTO) is not None and controls.set(FOCUS_AUTO, 0) != 0:
            raise CameraError(
                f"{path}: {NAMES[FOCUS_AUTO]} (control {FOCUS_AUTO:#010x}) cannot be switched off; use another camera"
            )
    with said(lines):
        focus = controls.query(FOCUS_ABSOLUTE)
    if focus is None or focus.highest <= focus.lowest:  # some drivers offer the control and no travel
        return None, lines
    return FocusRange(focus.lowest, focus.highest, max(focus.step, 1)), lines


def automatics(controls: Controls) -> dict[int, int]:
    """Which automatics a camera has, and how they are set: control -> value. A control that fails is left out."""
    found: dict[int, int] = {}
    for control in (*(lock.automatic for lock in LOCKS), FOCUS_AUTO):
        with said([]):
            if controls.query(control) is not None:
                found[control] = controls.get(control)
    return found


def gone(device: Device) -> CameraGone:
    return CameraGone(
        f"{device.path}: went away; was it unplugged? It may come back under another number: name it by what it is, "
        "v4l2:CARD, v4l2:BUS or a link in /dev/v4l/by-id"
    )
