"""The worker against a scripted camera: plans, order, regions, loss and return, closing."""

import threading
import time

import numpy as np
import pytest

from agent.clock.clock import SystemClock
from agent.kernel.config import Camera as CameraSettings
from agent.kernel.config import Fleet, Pose, Robot, Target
from agent.kernel.ranging.focus import Peak, fit_peak
from agent.kernel.step_io import SweepPlan
from agent.perception import vision
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import QUEUE, Vision
from hw.camera.camera import CameraError, CameraGone, FocusRange, Frame, Roi
from tests.perception.painted import CAMERA, ball_frame, sharp_position
from tests.sightings import collect
from tests.waiting import until

CENTRE_M = (0.02, 0.01, 0.9)
EMPTY = np.full((480, 640, 3), 90, np.uint8)


class ScriptedCamera:
    """A ball whose blur depends on the lens position; `gone` makes the next reads fail. Frames take no time."""

    size = (640, 480)

    def __init__(self, focusable=True, images=None):
        self.lens_position, self.seq, self.closed, self.gone = 0, 0, False, False
        self.focusable, self.calls = focusable, []
        self.images = images

    def focus_range(self):
        return FocusRange(0, 1023, 1) if self.focusable else None

    def set_focus(self, position):
        self.calls.append(("focus", position))
        self.lens_position = min(max(position, 0), 1023)
        return self.lens_position

    def read(self, roi=None, settle_s=0.0, timeout_s=1.0):
        if self.gone:
            raise CameraGone("no frame")
        self.calls.append(("read", roi, settle_s))
        self.seq += 1
        blur = 0.021 * abs(self.lens_position - sharp_position(CENTRE_M[2] - 0.07))
        image = self.images(blur)
        roi = roi or Roi(0, 0, 640, 480)
        part = image[roi.y : roi.y + roi.height, roi.x : roi.x + roi.width]
        return Frame(1_000_000 * self.seq, self.seq, part, roi)

    def close(self):
        self.closed = True


@pytest.fixture(scope="module")
def images():
    """Frames of the ball by blur diameter, drawn once."""
    drawn = {}

    def at(blur_px):
        key = round(2 * blur_px) / 2
        if key not in drawn:
            drawn[key] = ball_frame(CENTRE_M, key)
        return drawn[key]

    return at


def fleet_of_one(settle_s=0.03):
    robot = Robot(
        listen="tcp/127.0.0.1:17401", serial="x", camera="x", pose=Pose(x_m=0, y_m=0, yaw_deg=0), calibration="x"
    )
    return Fleet(
        fleet="tank",
        target={"ball": Target(radius_m=0.07)},
        robot={"r1": robot},
        camera=CameraSettings(settle_s=settle_s),
    )


@pytest.fixture
def worker(monkeypatch):
    """Start a worker on a list of cameras (or errors) to open one after the other; closed at the end."""
    monkeypatch.setattr(vision, "IDLE_PERIOD_S", 0.01)
    monkeypatch.setattr(vision, "HOMING_S", 0.01)
    monkeypatch.setattr(vision, "RETRY_S", (0.01, 0.02))
    started = []

    def start(*cameras, settle_s=0.03, on_frame=None, clock=None, find=None):
        waiting = list(cameras)

        def open_camera():
            camera = waiting.pop(0) if waiting else CameraError("no camera there; plug it in")
            if isinstance(camera, Exception):
                raise camera
            return camera

        fleet = fleet_of_one(settle_s)
        detectors = load_detectors(fleet, CAMERA)
        if find is not None:
            detectors["ball"].find = find
        out = Vision(open_camera, fleet, CAMERA, detectors, clock or SystemClock(), on_frame=on_frame)
        started.append(out)
        out.start()
        return out

    yield start
    for out in started:
        out.close()
    assert not [t for t in threading.enumerate() if t.name == "vision"]


def test_between_plans_every_frame_is_a_sighting(worker, images):
    camera = ScriptedCamera(images=images)
    seen = collect(worker(camera), lambda s: len(s) >= 3)
    assert [s.frame for s in seen[:3]] == [1, 2, 3]
    offset_ns = seen[0].t_ns - 1_000_000  # from the stamps of a camera to the time of day
    assert [s.t_ns - offset_ns for s in seen[:3]] == [1_000_000, 2_000_000, 3_000_000]
    assert offset_ns == pytest.approx(time.time_ns() - time.monotonic_ns(), abs=1e9)
    assert all(s.found and s.sweep == 0 and s.index == -1 and s.focus is None for s in seen)
    assert not [call for call in camera.calls if call[0] == "focus"]


def test_a_frame_without_the_ball_is_a_sighting_too(worker):
    seen = collect(worker(ScriptedCamera(images=lambda _: EMPTY)), lambda s: len(s) >= 2)
    assert all(not s.found and s.centre_px is None and s.clarity is None for s in seen)


def test_a_plan_is_carried_out_in_order_and_gives_the_peak(worker, images):
    camera = ScriptedCamera(images=images)
    lens_positions = tuple(range(60, 600, 30))
    out = worker(camera)
    collect(out, lambda s: len(s) >= 1)
    out.plan(SweepPlan(sweep=7, focus=(0, *lens_positions)))
    seen = [s for s in collect(out, lambda s: any(x.index == len(lens_positions) for x in s)) if s.sweep == 7]
    assert [s.focus for s in seen] == list(lens_positions)
    assert [s.index for s in seen] == list(range(1, len(lens_positions) + 1))
    peak = fit_peak([s.focus for s in seen], [s.clarity for s in seen])
    assert isinstance(peak, Peak)
    assert peak.lens_position == pytest.approx(sharp_position(CENTRE_M[2] - 0.07), abs=6)
    assert len({s.area_px for s in seen}) == 1 or np.ptp([s.area_px for s in seen]) < 0.01 * seen[0].area_px
    reads = [call for call in camera.calls if call[0] == "read" and call[1] is not None]
    assert all(call[2] == 0.03 and call[1].width < 400 for call in reads) and len(reads) >= len(lens_positions)


def test_a_newer_plan_replaces_the_one_under_way(worker, images):
    out = worker(ScriptedCamera(images=images))
    out.plan(SweepPlan(sweep=1, focus=tuple(range(100, 600))))
    collect(out, lambda s: any(x.sweep == 1 for x in s))
    out.plan(SweepPlan(sweep=2, focus=(200, 210, 220)))
    seen = collect(out, lambda s: any(x.sweep == 2 and x.index == 2 for x in s))
    later = [s.sweep for s in seen]
    assert 1 not in later[later.index(2) :]
    with pytest.raises(ValueError, match="no lens position"):
        out.plan(SweepPlan(sweep=3, focus=()))


def test_a_lost_camera_is_opened_again(worker, images):
    first, second = ScriptedCamera(images=images), ScriptedCamera(images=images)
    out = worker(first, CameraError("still away"), second)
    collect(out, lambda s: len(s) >= 1)
    first.gone = True
    while not second.seq:
        time.sleep(0.002)
    seen = collect(out, lambda s: len(s) >= 1)
    assert seen and first.closed and out.errors == 2
    collect(out, lambda s: len(s) >= 1)
    assert out.fault is None


def test_no_camera_at_all_is_a_fault_with_its_reason(worker):
    out = worker()
    while out.errors < 3:
        time.sleep(0.002)
    assert "plug it in" in out.fault
    assert out.drain() == []


def test_a_camera_without_focus_refuses_plans_and_goes_on(worker, images):
    out = worker(ScriptedCamera(focusable=False, images=images))
    out.plan(SweepPlan(sweep=1, focus=(0, 100)))
    seen = collect(out, lambda s: len(s) >= 3)
    assert out.refused == 1 and all(s.sweep == 0 for s in seen)


def test_what_nobody_fetches_is_bounded_and_counted(worker):
    out = worker(ScriptedCamera(images=lambda _: EMPTY))
    vision.IDLE_PERIOD_S = 0.0  # as fast as it goes; the fixture puts it back
    while out.dropped < 5:
        time.sleep(0.005)
    seen = out.drain()
    assert len(seen) <= QUEUE and seen[0].frame > 1


def test_every_frame_is_offered_to_the_recording(worker, images):
    frames = []
    out = worker(
        ScriptedCamera(images=images), on_frame=lambda frame, sightings: frames.append((frame.seq, sightings[0].frame))
    )
    collect(out, lambda s: len(s) >= 3)
    assert frames[:3] == [(1, 1), (2, 2), (3, 3)]


def test_closing_does_not_wait_for_the_next_frame(worker, images, monkeypatch):
    monkeypatch.setattr(vision, "IDLE_PERIOD_S", 60.0)
    camera = ScriptedCamera(images=images)
    out = worker(camera)
    collect(out, lambda s: len(s) >= 1)
    out.close()
    assert camera.closed


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
    assert faults[0] is not None and faults[0].startswith("IndexError in test_vision.py:")
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
    assert fault.startswith("vision has ended: SystemExit in test_vision.py:") and "start the agent again" in fault


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
