"""Vision on a dive's own clock, which waits for it: a clock, a thread's part in it, and a camera, in place of the real
ones."""

from __future__ import annotations

import threading

from hw.camera.camera import FocusRange, Frame, Roi, deliverable
from hw.twin.camera_device import DELIVERY_NS, DiveCamera, FrameClock
from hw.twin.dive import Dive

START_NS, STEP_TICKS = 10**15, 5


class LockstepClock:
    """The dive's time; a thread that waits has given the baton away and gets it back when its time has come."""

    camera_offset_ns, start_ns = 0, None

    def __init__(self, dive: Dive) -> None:
        self._dive, self.wake_ns = dive, 0
        self._ours, self._theirs = threading.Semaphore(0), threading.Semaphore(0)

    def now_ns(self) -> int:
        return self._dive.now_ns

    def sleep_until(self, t_ns: int) -> None:
        """By the other thread."""
        self.wake_ns = t_ns
        self._ours.release()
        self._theirs.acquire()

    def begin(self) -> None:
        """Wait until the other thread, just started, sleeps."""
        self._ours.acquire()

    def run_who_is_due(self) -> None:
        if self.wake_ns <= self.now_ns():
            self._theirs.release()
            self._ours.acquire()


class LockstepPart:
    """Stands in for agent.clock.clock.Part."""

    def __init__(self, clock: LockstepClock, name: str, slack_s: float) -> None:
        self._clock = clock

    def wait_changed(self, condition: threading.Condition, until_ns: int) -> bool:
        if self._clock.now_ns() >= until_ns:
            return False
        condition.release()
        self._clock.sleep_until(until_ns)
        condition.acquire()
        return self._clock.now_ns() < until_ns

    def resume(self) -> None:
        self._clock.wake_ns = self._clock.now_ns()


class LockstepCamera:
    """A camera of hw.camera.camera whose frames come when the dive has got there."""

    def __init__(self, clock: LockstepClock, shutter: FrameClock) -> None:
        self._clock, self._shutter = clock, shutter
        self._asked_ns: int | None = None  # for the frame that is rendered now
        self._settled_ns = 0
        self.device: DiveCamera | None = None  # that has now_ns for its clock

    @property
    def size(self) -> tuple[int, int]:
        return self.device.size

    def now_ns(self) -> int:
        return self._clock.now_ns() if self._asked_ns is None else self._asked_ns

    def focus_range(self) -> FocusRange:
        return self.device.focus_range

    def set_focus(self, lens_position: int) -> int:
        self._settled_ns = self._clock.now_ns()
        return self.device.set_focus(lens_position)

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = 0.0) -> Frame:
        asked_ns = max(self._clock.now_ns(), self._settled_ns + round(settle_s * 1e9))
        opens_ns = self._shutter.opens_ns(self._shutter.next(asked_ns))
        self._clock.sleep_until(opens_ns + DELIVERY_NS)
        self._asked_ns = opens_ns
        frame = self.device.read(deliverable(roi, self.size), 0.0)
        self._asked_ns = None
        return frame

    def close(self) -> None:
        pass
