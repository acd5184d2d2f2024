"""libcamera: a CSI camera of a Raspberry Pi, by its library picamera2. Untested on hardware: checked against a stand-in
at the library's face only.

Video4Linux gives of such a camera the sensor's raw mosaic alone: exposure, colours and lens are libcamera's. It is not
on PyPI for every system, so that it is imported when a camera of this kind is opened.
"""

from __future__ import annotations

import contextlib
import logging
import math
from collections.abc import Callable
from typing import Any, NamedTuple

from agent.clock import machine
from agent.core.config import MainsHz, to_install
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
    no_control,
)

SIZE = (640, 480)  # where none is asked for
PERIOD_US = 33_333  # 30 frames/s, whatever the light
BUFFERS = 3  # a control takes effect with the next request that is queued: as many frames later as there are buffers
WARM_UP_FRAMES = 30  # for the automatics to come to rest before they are held; 1 s
FIRST_FRAME_S = 3.0  # limit while warming up
HELD_WITHIN = 0.05  # of the exposure: a sensor exposes whole rows

# Lens positions are hundredths of a dioptre, 0 at infinity, in steps of what a ten-bit driver of 15 to 30 dioptres has.
PER_DIOPTRE = 100
STEP = 3

# controls by their names in libcamera's control_ids_core.yaml, and values of its enumerations
BEFORE = {
    "FrameDurationLimits": (PERIOD_US, PERIOD_US),
    "AfMode": 0,  # manual
    "Sharpness": 0.0,  # sharpening moves the focus peak
    "NoiseReductionMode": 0,  # off: it flattens the peak
    "AeFlickerMode": 1,  # manual: by AeFlickerPeriod
}
HELD = {  # what is held -> the switch of its automatic, and values that are then set
    "exposure": ("AeEnable", ("ExposureTime", "AnalogueGain")),
    "white balance": ("AwbEnable", ("ColourGains",)),
}

logger = logging.getLogger(__name__)


class Picture(NamedTuple):
    image: Image
    began_ns: int  # of the exposure of the first row, CLOCK_MONOTONIC
    middle_ns: int
    about: dict[str, Any]  # the request's metadata


def library(place: str) -> Any:
    """The class Picamera2. Raises CameraError where it is not installed."""
    try:
        from picamera2 import Picamera2
    except ImportError as error:
        raise CameraError(
            f"camera 'libcamera:{place}': needs picamera2 ({error}); sudo apt install python3-picamera2 and a virtual "
            f"environment with --system-site-packages, or {to_install('picamera')}"
        ) from None
    return Picamera2


def models() -> list[str]:
    """What libcamera finds, in the order of its numbers. Raises CameraError where picamera2 is not installed."""
    return [str(about.get("Model") or about.get("Id")) for about in library("0").global_camera_info()]


def find(place: str) -> tuple[int, str]:
    """Number and model of the camera that an address means; nothing is opened. Raises CameraError, CameraGone."""
    if not place.isdecimal():
        raise CameraError(f"camera 'libcamera:{place}': cameras have numbers here; write libcamera:0")
    known, number = models(), int(place)
    if number >= len(known):
        there = ", ".join(f"libcamera:{k} ({model})" for k, model in enumerate(known)) or "none at all"
        raise CameraGone(f"camera 'libcamera:{place}': is not there; there is {there}; see rpicam-hello --list-cameras")
    return number, known[number]


def plugged_in(clock_ns: Callable[[], int] = machine.monotonic_ns) -> list[Found]:
    """Every camera of libcamera, opened for a moment; none where picamera2 is not installed."""
    try:
        known = models()
    except CameraError:
        return []
    return [_tried(number, model, clock_ns) for number, model in enumerate(known)]


def _tried(number: int, model: str, clock_ns: Callable[[], int]) -> Found:
    try:
        with contextlib.closing(set_up(number, None, 50, clock_ns)) as camera:
            facts = (
                ("pictures", "{}x{}, 30/s".format(*camera.size)),
                focus_fact(camera.focus_range()),
                exposure_fact(camera.exposure_ns),
                ("stamps", camera.stamp),
            )
            return Found(model, f"libcamera:{number}", facts, camera.shortcomings)
    except CameraError as error:
        return Found(model, "", (), (), str(error))


def open_libcamera(
    place: str, size: tuple[int, int] | None, mains_hz: MainsHz = 50, clock_ns: Callable[[], int] = machine.monotonic_ns
) -> LibCamera:
    """Open the camera of this number; let its automatics settle and hold them.

    size: width and height, pixels; SIZE if not given. mains_hz: 50 or 60, what lamps flicker by. Raises CameraError,
    CameraGone if it is not there now. What the camera lacks is said once, on the log.
    """
    number, model = find(place)
    camera = set_up(number, size, mains_hz, clock_ns)
    for line in camera.shortcomings:
        logger.warning("libcamera:%d ('%s'): %s", number, model, line)
    return camera


def set_up(number: int, size: tuple[int, int] | None, mains_hz: MainsHz, clock_ns: Callable[[], int]) -> LibCamera:
    """The same of a camera that was found, without a word on the log."""
    name = f"camera 'libcamera:{number}'"
    with contextlib.ExitStack() as undo:
        try:
            device = library(str(number))(number)
            undo.callback(device.close)
            known = device.camera_controls
            before = {**BEFORE, "AeFlickerPeriod": 1_000_000 // (2 * mains_hz)}  # us: a lamp is lit in both half waves
            main = {"size": size or SIZE, "format": "RGB888"}  # which libcamera keeps as blue green red
            device.configure(device.create_video_configuration(main=main, buffer_count=BUFFERS))
            device.set_controls({control: value for control, value in before.items() if control in known})
            device.start()
        except (RuntimeError, IndexError) as error:  # all that picamera2 says of a camera that another program has
            raise CameraGone(f"{name}: cannot be opened ({error}); end other programs that use it") from None
        camera = LibCamera(device, name, _focus(known), clock_ns, undo.pop_all())
    try:
        camera.hold(known)
    except CameraError:
        camera.close()
        raise
    return camera


def _focus(known: dict[str, tuple[Any, Any, Any]]) -> FocusRange | None:
    near, far = known.get("LensPosition", (0.0, 0.0, 0.0))[1::-1]  # dioptres: more is nearer
    lowest, highest = math.ceil(far * PER_DIOPTRE), math.floor(near * PER_DIOPTRE)
    return FocusRange(lowest, highest, STEP) if highest >= lowest + STEP else None


class LibCamera:
    """A camera that runs; `hold` it once. After CameraGone it has to be closed and opened again.

    A control takes effect some frames after it was set, and a lens goes far in several steps. Each frame says where the
    lens was told to be when the frame was processed, which is after it was exposed: the lens settles from the arrival
    of the first frame that says so.
    """

    # The driver stamps the first row's readout, the end of its exposure, and each frame tells how long that took.
    stamp: Stamp = "exposure-start"

    def __init__(
        self, device: Any, name: str, focus: FocusRange | None, clock_ns: Callable[[], int], undo: contextlib.ExitStack
    ) -> None:
        self.size: tuple[int, int] = tuple(device.camera_configuration()["main"]["size"])
        self.exposure_ns = 0  # for how long frames are exposed, once it is held; 0: it cannot be set
        self.shortcomings: tuple[str, ...] = ()  # what it cannot do that a good camera can, a line each
        self._device, self._name, self._focus, self._clock_ns, self._undo = device, name, focus, clock_ns, undo
        self._wanted: int | None = None  # lens position that was asked for and that no frame has told yet
        self._told_ns = 0  # since when the lens was told to be where it is
        self._seq = 0

    def hold(self, known: dict[str, tuple[Any, Any, Any]]) -> None:
        """Hold exposure, gain and white balance where the automatics leave them. known: the device's controls."""
        about = self._pass_over(WARM_UP_FRAMES)
        missing: list[str] = []
        wanted: dict[str, Any] = {}
        for what, (switch, values) in HELD.items():
            if switch not in known or not all(value in known and value in about for value in values):
                missing.append(what)
                continue
            wanted |= {switch: False, **{value: about[value] for value in values}}
        self._device.set_controls(wanted)
        held = self._pass_over(2 * BUFFERS)
        lines = [no_control(missing)] if missing else []
        if "ExposureTime" in wanted:
            self.exposure_ns = held["ExposureTime"] * 1000
            asked, got = wanted["ExposureTime"], held["ExposureTime"]
            if abs(got - asked) > HELD_WITHIN * asked:
                lines.append(f"its exposure is not held: {got} us in place of {asked}")
        if self._focus is not None and "LensPosition" not in about:  # it would take every position and go nowhere
            self._focus = None
            lines.append("libcamera's tuning file of its sensor says nothing of a lens (rpi.af): take its maker's file")
        self.shortcomings = (*lines, *([NO_FOCUS] if self._focus is None else []))

    def focus_range(self) -> FocusRange | None:
        return self._focus

    def set_focus(self, lens_position: int) -> int:
        if self._focus is None:
            raise CameraError(f"{self._name}: its focus cannot be set; use a camera with the control LensPosition")
        self._wanted = nearest(lens_position, self._focus)
        self._told_ns = self._clock_ns()
        self._device.set_controls({"LensPosition": self._wanted / PER_DIOPTRE})
        return self._wanted

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        part = deliverable(roi, self.size)
        asked_ns = self._clock_ns()
        until_ns = asked_ns + round(timeout_s * 1e9)
        while (left_ns := until_ns - self._clock_ns()) > 0:
            picture = self._next(left_ns * 1e-9)
            if picture is None:
                break
            not_before_ns = max(asked_ns, self._told_ns + round(settle_s * 1e9))
            if self._wanted is None and picture.began_ns >= not_before_ns:
                pixels = picture.image[part.y : part.y + part.height, part.x : part.x + part.width].copy()
                return Frame(picture.middle_ns, self._seq, pixels, part)
        where = "" if self._wanted is None else f" with the lens at {self._wanted / PER_DIOPTRE:g} dioptres"
        raise CameraGone(f"{self._name}: no new frame{where} within {timeout_s:g} s; opening it again")

    def close(self) -> None:
        self._undo.close()

    def _pass_over(self, frames: int) -> dict[str, Any]:
        """What the last of so many frames says of itself."""
        about: dict[str, Any] = {}
        for _ in range(frames):
            picture = self._next(FIRST_FRAME_S)
            if picture is None:
                raise CameraGone(f"{self._name}: no frame within {FIRST_FRAME_S:g} s; look at its cable")
            about = picture.about
        return about

    def _next(self, timeout_s: float) -> Picture | None:
        """The next frame, whatever it shows; None: none came in time. Raises CameraGone."""
        try:
            request = self._device.wait(self._device.capture_request(wait=False), timeout=timeout_s)
        except TimeoutError:
            return None
        except RuntimeError as error:
            raise CameraGone(f"{self._name}: gives no frames ({error}); opening it again") from None
        try:
            about, image = request.get_metadata(), request.make_array("main")
        finally:
            request.release()
        if "SensorTimestamp" not in about or "ExposureTime" not in about:
            raise CameraError(f"{self._name}: does not say when its frames were exposed; open a USB camera as v4l2:")
        self._seq += 1
        told = about.get("LensPosition", math.inf)
        if self._wanted is not None and abs(told * PER_DIOPTRE - self._wanted) < STEP / 2:
            self._wanted, self._told_ns = None, self._clock_ns()
        exposure_ns = about["ExposureTime"] * 1000
        began_ns = about["SensorTimestamp"] - exposure_ns
        return Picture(image, began_ns, began_ns + exposure_ns // 2, about)
