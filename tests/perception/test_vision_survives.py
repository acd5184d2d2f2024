"""The worker outlives frames that are none and whatever breaks off over them, and says so."""

import threading

import numpy as np
import pytest

from agent.clock.clock import SystemClock
from agent.perception.detection.detectors import load_detectors
from hw.camera.camera import Frame, Roi
from tests.perception.painted import CAMERA
from tests.perception.scripted_camera import EMPTY, ScriptedCamera, fleet_of_one
from tests.sightings import collect
from tests.waiting import until


class OddFrames(ScriptedCamera):
    """Delivers `frame` instead of what it sees."""

    def __init__(self, frame):
        super().__init__()
        self.frame = frame

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        self.seq += 1
        return self.frame


def breaks(*_, **__):
    raise IndexError("on purpose\nin two lines")


def comes_back(out, first, second):
    """The first camera is closed, and the second one's frames become sightings with no fault left."""
    until(lambda: second.seq)
    assert collect(out, lambda s: any(x.found for x in s))
    until(lambda: out.fault is None)
    assert first.closed and second.seq and out._thread.is_alive()


@pytest.mark.parametrize(
    "frame",
    [
        Frame(1, 1, np.zeros((0, 0, 3), np.uint8), Roi(0, 0, 0, 0)),
        Frame(1, 1, EMPTY[:, :, 0], Roi(0, 0, 640, 480)),
        Frame(1, 1, EMPTY.astype(np.float64), Roi(0, 0, 640, 480)),
        Frame(1, 1, EMPTY[:100], Roi(0, 0, 640, 480)),
        None,
    ],
    ids=["0 x 0", "one channel", "floats", "cut off", "none"],
)
def test_what_is_no_frame_is_a_fault_and_the_camera_is_opened_again(worker, images, frame):
    first, second = OddFrames(frame), ScriptedCamera(images=images)
    frames = []
    out = worker(first, second, on_frame=lambda frame, _: frames.append(frame))
    comes_back(out, first, second)
    assert out.errors + out.broken == 1 and not any(one is frame for one in frames)


def test_a_detector_that_raises_is_told_with_its_place_and_does_not_end_vision(worker, images):
    faults, finds = [], iter(range(1000))

    def find(image, offset_px, lens_position):
        if next(finds) < 2:
            breaks()
        faults.append(out.fault)
        return real(image, offset_px=offset_px, lens_position=lens_position)

    cameras = [ScriptedCamera(images=images) for _ in range(3)]
    real = load_detectors(fleet_of_one(), CAMERA)["ball"].find
    out = worker(*cameras, find=find)
    comes_back(out, cameras[1], cameras[2])
    assert out.broken == 2 and cameras[0].closed
    assert faults[0] is not None and faults[0].startswith("IndexError in test_vision_survives.py:")
    assert "on purpose in two lines" in faults[0]


def test_a_recording_that_raises_is_told_and_the_next_frame_is_looked_at(worker, images):
    frames = []

    def on_frame(frame, _):
        frames.append(frame)
        if len(frames) == 1:
            breaks()

    first, second = ScriptedCamera(images=images), ScriptedCamera(images=images)
    out = worker(first, second, on_frame=on_frame)
    until(lambda: len(frames) >= 3)
    comes_back(out, first, second)
    assert out.broken == 1


def test_a_camera_that_breaks_on_closing_is_opened_again(worker, images):
    first, second = ScriptedCamera(images=images), ScriptedCamera(images=images)

    def close():
        first.closed = True
        breaks()

    first.close = close
    out = worker(first, second)
    collect(out, lambda s: len(s) >= 1)
    first.gone = True
    comes_back(out, first, second)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_has_ended_is_told(worker, images):
    def on_frame(*_):
        raise SystemExit("no more")

    out = worker(ScriptedCamera(images=images), on_frame=on_frame)
    fault = until(lambda: out.fault)
    assert (
        fault.startswith("vision has ended: SystemExit in test_vision_survives.py:")
        and "start the agent again" in fault
    )


class FastClock(SystemClock):
    """A hundred times the wall's speed."""

    def now_ns(self):
        return 100 * super().now_ns()

    def wall_s(self, until_ns):
        return max(0.0, (until_ns - self.now_ns()) * 1e-11)


def test_pictures_that_stand_still_are_a_fault_until_they_move(worker):
    rng = np.random.default_rng(1)
    moving = threading.Event()
    camera = ScriptedCamera(
        images=lambda _: EMPTY ^ rng.integers(0, 2, EMPTY.shape, np.uint8) if moving.is_set() else EMPTY
    )
    out = worker(camera, clock=FastClock())
    assert "same picture" in until(lambda: out.frozen)
    assert out.fault is None and not camera.closed
    moving.set()
    until(lambda: out.frozen is None)
