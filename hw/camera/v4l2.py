"""v4l2: a USB or CSI camera under Linux. Untested on hardware: checked against a fake of the driver's calls only.

Nothing stands between us and the driver: only its own stamps say which frame shows which lens position, and only it
tells the range of its focus.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from agent.clock import machine
from hw.camera import v4l2_calls as v4l2
from hw.camera.camera import PATIENCE_S, CameraError, FocusRange, Frame, Roi, deliverable, nearest
from hw.camera.v4l2_calls import Device
from hw.camera.v4l2_controls import Controls, free_focus, freeze
from hw.camera.v4l2_format import MJPG, Format, negotiate
from hw.camera.v4l2_node import LINUX, System, find
from hw.camera.v4l2_stream import Stream

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
