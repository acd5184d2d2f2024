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
from agent.core.config import MainsHz
from agent.core.picture_head import stated_size
from hw.camera import v4l2_node as v4l2
from hw.camera.camera import (
    NO_FOCUS,
    PATIENCE_S,
    CameraError,
    CameraGone,
    FocusRange,
    Found,
    Frame,
    Image,
    Roi,
    Stamp,
    deliverable,
    exposure_fact,
    focus_fact,
    nearest,
)
from hw.camera.v4l2_node import (
    BUFFER_TYPE,
    ENCODINGS,
    FORMAT,
    LINUX,
    MJPG,
    NV12,
    REQUEST_BUFFERS,
    STREAM_PARAMETERS,
    UYVY,
    YUYV,
    Buffer,
    Controls,
    Device,
    Identity,
    System,
    automatics,
    find,
    free_focus,
    freeze,
    gone,
    said,
)

# --- format: size, encoding and frame rate ---

COLOURS = {YUYV: cv2.COLOR_YUV2BGR_YUYV, UYVY: cv2.COLOR_YUV2BGR_UYVY}  # of two bytes a pixel, side by side
WANTED_HZ = 30
SLOWEST_NS = 66_700_000  # below 15 frames/s a full sweep takes 4 s; then JPEG is the smaller evil
UNKNOWN_NS = 1_000_000_000 // WANTED_HZ  # period of a driver that does not tell
END_OF_JPEG = b"\xff\xd9"


class Format(NamedTuple):
    size: tuple[int, int]  # width, height
    fourcc: int
    stride: int  # bytes from one row to the next, of all but JPEG
    period_ns: int  # between frames


def negotiate(device: Device, buffers: int, size: tuple[int, int] | None) -> Format:
    """The best format of `size`, by default the size that is set, or what comes nearest to it. Raises CameraError.

    buffers: BUF_TYPE of the node.
    """
    try:
        wanted = size or _current_size(device, buffers)
        offers = [offer for fourcc in ENCODINGS if (offer := _offer(device, buffers, fourcc, wanted)) is not None]
        if not offers:
            raise CameraError(f"{device.path}: {_unread(v4l2.format_offers(device, buffers))}")
        best = min(offers, key=lambda o: (o.size != wanted, o.period_ns > SLOWEST_NS, ENCODINGS.index(o.fourcc)))
        return _set(device, buffers, best.fourcc, best.size)
    except OSError as error:
        if error.errno == errno.ENODEV:
            raise gone(device) from None
        why = "another program uses it" if error.errno == errno.EBUSY else error.strerror
        raise CameraError(f"{device.path}: its format cannot be set: {why}; see fuser and v4l2-ctl --all") from None


def _unread(offers: list[v4l2.FormatOffer]) -> str:
    """Why no format of a node is read, and what to use in its place."""
    names = ", ".join(v4l2.name_of(offer.fourcc) for offer in offers) or "formats that it does not list"
    if any("Bayer" in offer.description for offer in offers):
        return f"gives the sensor's raw mosaic ({names}), as CSI cameras do; write libcamera:0 in the fleet file"
    if offers and all(offer.compressed for offer in offers):
        return f"gives film alone ({names}), no whole pictures; use its node of YUYV or MJPG, or another camera"
    return f"gives {names}, and none of YUYV, UYVY, NV12 and MJPG; use another camera"


def decode(data: memoryview, form: Format) -> Image | None:
    """The picture in a buffer's filled part, (height, width, 3) blue green red; None if it is torn."""
    width, height = form.size
    if form.fourcc == MJPG:
        jpeg = bytes(data).rstrip(b"\0")  # some drivers pad
        if not jpeg.endswith(END_OF_JPEG) or stated_size(jpeg) != form.size:
            return None
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
        return None if image is None or image.shape != (height, width, 3) else np.asarray(image, np.uint8)
    # NV12: a byte of brightness each, then half as many rows of colours
    rows, in_row = (height * 3 // 2, width) if form.fourcc == NV12 else (height, 2 * width)
    if len(data) < form.stride * (rows - 1) + in_row:
        return None
    raw = np.lib.stride_tricks.as_strided(np.frombuffer(data, np.uint8), (rows, in_row), (form.stride, 1))
    if form.fourcc == NV12:
        return np.asarray(cv2.cvtColor(np.ascontiguousarray(raw), cv2.COLOR_YUV2BGR_NV12), np.uint8)
    pairs = np.ascontiguousarray(raw).reshape(height, width, 2)
    return np.asarray(cv2.cvtColor(pairs, COLOURS[form.fourcc]), np.uint8)


def _current_size(device: Device, buffers: int) -> tuple[int, int]:
    argument = bytearray(FORMAT.pack(buffers, *12 * (0,)))
    device.ioctl(v4l2.G_FMT, argument)
    _, width, height, *_ = FORMAT.unpack(argument)
    return width, height


def _offer(device: Device, buffers: int, fourcc: int, size: tuple[int, int]) -> Format | None:
    """What a driver makes of a format; None if it does not have it, which some say by an error."""
    try:
        offer = _set(device, buffers, fourcc, size)
    except OSError as error:
        if error.errno == errno.EINVAL:
            return None
        raise
    return offer if offer.fourcc == fourcc else None


def _set(device: Device, buffers: int, fourcc: int, size: tuple[int, int]) -> Format:
    """Ask for a format; a driver takes the nearest that it has."""
    argument = bytearray(FORMAT.pack(buffers, *size, fourcc, v4l2.FIELD_NONE, *8 * (0,)))
    device.ioctl(v4l2.S_FMT, argument)
    _, width, height, got, _, stride, _, stride_of_plane, *_ = FORMAT.unpack(argument)
    if buffers == v4l2.BUF_TYPE_VIDEO_CAPTURE_MPLANE:
        stride = stride_of_plane
    in_row = width if got == NV12 else 2 * width
    return Format((width, height), got, max(stride, in_row), _set_period_ns(device, buffers))


def _set_period_ns(device: Device, buffers: int) -> int:
    argument = bytearray(STREAM_PARAMETERS.pack(buffers, 0, 0, 1, WANTED_HZ, 0, 0))
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


def exposed(
    flags: int, stamp_ns: int, arrived_ns: int, exposure_ns: int, period_ns: int, first_packet: bool = False
) -> Exposure:
    """When the frame of a buffer was exposed.

    first_packet: whatever the flags say, the stamp is the arrival of a frame's first bytes. A camera that holds a frame
    back before it sends it is a period late, and then the exposure had begun one exposure and one period before: that
    is taken for all, since a frame that is thought too old is only left out. Other drivers stamp the start of the
    exposure and say so, or the end of the transfer, before which there were, at the earliest, the exposure and one
    period for reading the sensor out. A stamp of an unknown clock is replaced by the arrival.
    """
    known = clock_is_known(flags, stamp_ns, arrived_ns, period_ns)
    took_ns = exposure_ns + period_ns
    if known and first_packet:
        return Exposure(stamp_ns - took_ns, stamp_ns - took_ns + exposure_ns // 2)
    if known and flags & v4l2.BUF_FLAG_TSTAMP_SRC_MASK == v4l2.BUF_FLAG_TSTAMP_SRC_SOE:
        return Exposure(stamp_ns, stamp_ns + exposure_ns // 2)
    began_ns = (stamp_ns if known else arrived_ns) - took_ns
    return Exposure(began_ns, began_ns + took_ns // 2)


class Stream:
    """Frames of one device, each with the time at which it was exposed.

    Started once with a format that is set, closed once. `exposure_ns` may be set at any time. buffers: BUF_TYPE of the
    node; first_packet: see `exposed`.
    """

    def __init__(
        self, device: Device, buffers: int, form: Format, clock_ns: Callable[[], int], first_packet: bool
    ) -> None:
        self.exposure_ns = 0
        self.clock_known = True  # of the newest frame
        self.stamp: Stamp = "arrival"  # likewise
        self._device, self._type, self._form, self._clock_ns = device, buffers, form, clock_ns
        self._first_packet = first_packet
        self._buffers: list[memoryview] = []
        self._number = 0

    def start(self) -> None:
        """Raises CameraError where the driver has no buffers to give, as when another program reads from it."""
        try:
            argument = bytearray(REQUEST_BUFFERS.pack(BUFFERS, self._type, v4l2.MEMORY_MMAP, 0))
            self._device.ioctl(v4l2.REQBUFS, argument)
            for number in range(REQUEST_BUFFERS.unpack(argument)[0]):
                buffer = v4l2.buffer_call(self._device, v4l2.QUERYBUF, self._type, number)
                self._buffers.append(self._device.map(buffer.offset, buffer.length))
                v4l2.buffer_call(self._device, v4l2.QBUF, self._type, number)
            self._device.ioctl(v4l2.STREAMON, bytearray(BUFFER_TYPE.pack(self._type)))
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
            buffer = self._call(v4l2.DQBUF, 0)
            if buffer is None:
                continue
            when = self._exposed(buffer.flags, buffer.stamp_ns)
            self._number += 1
            usable = when.began_ns >= not_before_ns and not buffer.flags & v4l2.BUF_FLAG_ERROR
            image = decode(self._buffers[buffer.number][: buffer.filled], self._form) if usable else None
            self._call(v4l2.QBUF, buffer.number)
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
            self._device.ioctl(v4l2.STREAMOFF, bytearray(BUFFER_TYPE.pack(self._type)))
        for view in self._buffers:
            view.release()
        self._buffers.clear()

    def _exposed(self, flags: int, stamp_ns: int) -> Exposure:
        arrived_ns, period_ns = self._clock_ns(), self._form.period_ns
        self.clock_known = clock_is_known(flags, stamp_ns, arrived_ns, period_ns)
        start = flags & v4l2.BUF_FLAG_TSTAMP_SRC_MASK == v4l2.BUF_FLAG_TSTAMP_SRC_SOE and not self._first_packet
        self.stamp = "exposure-start" if self.clock_known and start else "arrival"
        return exposed(flags, stamp_ns, arrived_ns, self.exposure_ns, period_ns, self._first_packet)

    def _call(self, request: int, number: int) -> Buffer | None:
        """None: there is nothing after all."""
        try:
            return v4l2.buffer_call(self._device, request, self._type, number)
        except OSError as error:
            if error.errno == errno.EAGAIN:
                return None
            if error.errno == errno.ENODEV:
                raise gone(self._device) from None
            raise CameraGone(f"{self._device.path}: its driver fails: {error.strerror}; opening it again") from None


# --- camera ---

WARM_UP_FRAMES = 20  # for the automatic exposure to come to rest before it is locked; 0.7 s at 30 frames/s
FIRST_FRAME_S = 3.0  # limit while warming up; cameras need up to two seconds after they were plugged in
TAKES_EFFECT_FRAMES = 3  # until a control is seen in a picture, of the cameras whose data sheets say so
JUMP = 1.6  # of the mean byte, 2.8 of light: more than a robot that drifts changes in a tenth of a second
BURNT = 250  # bytes from here on show nothing
BLACK = 12  # mean byte below which there is hardly a picture

logger = logging.getLogger(__name__)


def open_v4l2(
    place: str,
    size: tuple[int, int] | None,
    mains_hz: MainsHz = 50,
    system: System = LINUX,
    clock_ns: Callable[[], int] = machine.monotonic_ns,
) -> V4l2Camera:
    """Open the camera at a path, or of a name or port; let its exposure settle and lock it.

    `size` is asked for, see `negotiate` for what comes. mains_hz: 50 or 60, what lamps flicker by. Raises CameraError,
    CameraGone if nothing is there now. What the camera lacks is said once, on the log.
    """
    device, who = find(place, system)
    camera = set_up(device, who, size, mains_hz, system, clock_ns)
    for line in camera.shortcomings:
        logger.warning("%s ('%s'): %s", device.path, who.card, line)
    return camera


def set_up(
    device: Device,
    who: Identity,
    size: tuple[int, int] | None,
    mains_hz: MainsHz,
    system: System,
    clock_ns: Callable[[], int],
) -> V4l2Camera:
    """The same of a device that was found, without a word on the log. The device is closed if it cannot be used."""
    with contextlib.ExitStack() as undo:
        undo.callback(device.close)
        form = negotiate(device, who.buffers, size)
        first_packet = who.driver == "uvcvideo" and not system.hardware_stamps()
        stream = Stream(device, who.buffers, form, clock_ns, first_packet)
        undo.callback(stream.close)
        stream.start()
        for _ in range(WARM_UP_FRAMES):
            picture = stream.next(0, FIRST_FRAME_S)
        controls = Controls(device)
        found = automatics(controls)
        undo.callback(_put_back, controls, found)
        lines = freeze(controls, mains_hz)
        focus, failed = free_focus(controls, device.path)
        lines += failed
        with said(lines):
            if controls.query(v4l2.EXPOSURE_ABSOLUTE) is not None:
                stream.exposure_ns = controls.get(v4l2.EXPOSURE_ABSOLUTE) * 100_000
        taken_ns = clock_ns() + TAKES_EFFECT_FRAMES * form.period_ns
        held = stream.next(taken_ns, FIRST_FRAME_S)
        measured = found.get(v4l2.EXPOSURE_AUTO, v4l2.EXPOSURE_MANUAL) not in v4l2.EXPOSURE_HELD
        lines += check_brightness(device.path, picture.image if measured else None, held.image)
        lines += shortcomings(focus, form, stream.clock_known)
        return V4l2Camera(device, controls, stream, form, focus, clock_ns, tuple(lines), undo.pop_all())


def _put_back(controls: Controls, found: dict[int, int]) -> None:
    """Automatics as they were found: the next opening measures anew, and knows what a person has set by hand."""
    for control, value in found.items():
        with contextlib.suppress(CameraError):  # it may be gone
            controls.set(control, value)


def check_brightness(path: str, measured: Image | None, held: Image) -> list[str]:
    """Whether an exposure that is held shows anything; a line about a dark one that may be right, at night.

    measured: the last picture of the automatic exposure, (height, width, 3) as `held`; None: there is none, or a person
    had switched it off. Raises CameraError.
    """
    by_hand = f"set it by hand: v4l2-ctl -d {path} -c auto_exposure=1,exposure_time_absolute=N"
    if measured is not None:
        times = (float(held.mean()) + BLACK) / (float(measured.mean()) + BLACK)
        if not 1.0 / JUMP <= times <= JUMP:
            raise CameraError(
                f"{path}: its pictures are much {'brighter' if times > 1.0 else 'darker'} once the exposure is held: "
                f"its driver does not tell what the automatic has measured; {by_hand}"
            )
    elif np.median(held) >= BURNT:
        raise CameraError(f"{path}: its exposure is constant, and its pictures are burnt out; {by_hand}")
    elif held.mean() < BLACK:
        return [f"its exposure is constant, and its pictures are nearly black; if it is not dark there, {by_hand}"]
    return []


class V4l2Camera:
    """A camera that is set up. After CameraGone it has to be closed and opened again. `undo` ends what was begun."""

    def __init__(
        self,
        device: Device,
        controls: Controls,
        stream: Stream,
        form: Format,
        focus: FocusRange | None,
        clock_ns: Callable[[], int],
        shortcomings: tuple[str, ...],
        undo: contextlib.ExitStack,
    ) -> None:
        self.size = form.size
        self.form = form
        self.shortcomings = shortcomings  # what it cannot do that a good camera can, a line each
        self._device, self._controls, self._stream = device, controls, stream
        self._focus, self._clock_ns, self._undo = focus, clock_ns, undo
        self._focus_set_ns = 0

    @property
    def stamp(self) -> Stamp:
        return self._stream.stamp

    @property
    def exposure_ns(self) -> int:
        """For how long frames are exposed; 0: it does not tell."""
        return self._stream.exposure_ns

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
        self._undo.close()


def shortcomings(focus: FocusRange | None, form: Format, clock_known: bool) -> list[str]:
    """What this camera cannot do that a good one can, beside its controls, a line each."""
    lines = []
    if focus is None:
        lines.append(NO_FOCUS)
    if form.fourcc == MJPG:
        lines.append("it delivers this size as JPEG only, or too slowly: the focus is found less exactly")
    if not clock_known:
        lines.append("its driver stamps frames by an unknown clock: their arrival counts, some milliseconds late")
    return lines


# --- what is plugged in ---

LISTED_SIZE = (640, 480)  # in which a camera is tried


def plugged_in(system: System = LINUX, clock_ns: Callable[[], int] = machine.monotonic_ns) -> list[Found]:
    """Every node that gives pictures, opened for a moment."""
    found: list[Found] = []
    there: list[tuple[str, Identity, bool]] = []  # path, and whether a format of it is read
    for path in system.nodes():
        try:
            device = v4l2.opened(path, system)
        except CameraGone:
            continue
        except CameraError as error:
            found.append(Found(path, "", (), (), str(error)))
            continue
        with contextlib.closing(device), contextlib.suppress(OSError):  # not a video device, whatever its name
            who = v4l2.identity(device)
            if who.captures:
                there.append((path, who, v4l2.useful(device, who)))
    for path, who, read in there:
        same = [other for _, other, also in there if also and other.card == who.card]
        address = f"v4l2:{who.bus if len(same) > 1 else who.card}" if read else f"v4l2:{path}"
        found.append(_tried(path, who, address, system, clock_ns))
    return found


def _tried(path: str, who: Identity, address: str, system: System, clock_ns: Callable[[], int]) -> Found:
    facts = [("at", f"{path}, {who.driver}, {who.bus}")]
    try:
        device, _ = find(path, system)
        with contextlib.suppress(OSError):
            facts += [("format", _listed(device, offer.fourcc)) for offer in v4l2.format_offers(device, who.buffers)]
        with contextlib.closing(set_up(device, who, LISTED_SIZE, 50, system, clock_ns)) as camera:
            (width, height), form = camera.size, camera.form
            facts += [
                ("pictures", f"{width}x{height} {v4l2.name_of(form.fourcc)}, {1e9 / form.period_ns:.3g}/s"),
                focus_fact(camera.focus_range()),
                exposure_fact(camera.exposure_ns),
                ("stamps", camera.stamp),
            ]
            return Found(who.card, address, tuple(facts), camera.shortcomings)
    except CameraError as error:
        return Found(who.card, "", (), (), str(error))


def _listed(device: Device, fourcc: int) -> str:
    sizes = []
    for width, height in v4l2.size_offers(device, fourcc):
        hz = v4l2.rate_offer(device, fourcc, (width, height))
        sizes.append(f"{width}x{height} {hz:.3g}/s" if hz else f"{width}x{height}")
    return f"{v4l2.name_of(fourcc)} {', '.join(sizes)}" if fourcc in ENCODINGS else f"{v4l2.name_of(fourcc)}, not read"
