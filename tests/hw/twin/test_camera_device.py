"""When a camera of the twin exposes, from where, and what it waits for; with a painter that only takes notes."""

import math
import threading

import numpy as np
import pytest

from hw.camera.camera import CameraGone, Roi
from hw.twin.camera_device import EXPOSURE_NS, FRAME_NS, DiveCamera, FrameClock, look
from hw.twin.dive import RobotPose
from hw.twin.optics.lens import draw_lens
from hw.twin.physics.body import matrix, quaternion
from hw.twin.truth import Stage
from tests.hw.twin.filled_history import START_NS, filled, states
from tests.waiting import until


class Notebook:
    """Stands in for the painter and for the lens's motor."""

    def __init__(self):
        self.frames, self.asked, self.moments = [], [], []

    def expose(self, middle, image_distance_m, roi=None, tick=0, during=None):
        self.frames.append((middle.eye, image_distance_m, middle.hulls, roi, tick))
        self.moments.append(middle)
        self.during = during
        return np.zeros((2, 2, 3), np.uint8)

    def command(self, lens_position, t_ns):
        return lens_position

    def image_distance_m(self, t_ns, tilt_rad):
        self.asked.append((t_ns, tilt_rad))
        return 0.004


def camera(history, now_ns, notebook=None, late_ns=0):
    notebook = notebook or Notebook()
    lens = draw_lens("imx519_640", np.random.default_rng(0))
    seen = (history, lens, notebook, notebook, (0.1, 0.0, 0.0), Stage((), ()))
    return DiveCamera(0, *seen, FrameClock(START_NS), now_ns, late_ns=late_ns), notebook


def test_the_frame_is_the_first_exposed_after_the_request():
    source, notebook = camera(filled(100), lambda: START_NS + 5 * FRAME_NS + 1)
    frame = source.read(None, 0.0)
    assert frame.seq == 6
    assert frame.t_ns == START_NS + 6 * FRAME_NS + EXPOSURE_NS // 2
    assert notebook.asked[0][0] == frame.t_ns
    assert notebook.frames[0][4] == frame.seq
    assert frame.roi == (0, 0, 640, 480)


def test_the_lens_is_given_its_time_to_settle():
    source, _ = camera(filled(100), lambda: START_NS + 5 * FRAME_NS)
    source.set_focus(300)
    frame = source.read(Roi(8, 16, 32, 64), 0.05)
    assert frame.t_ns - EXPOSURE_NS // 2 >= START_NS + 5 * FRAME_NS + 50_000_000
    assert frame.seq == 7
    assert frame.roi == (8, 16, 32, 64)


def test_late_stamps_pass_a_frame_for_one_that_was_exposed_later():
    source, notebook = camera(filled(100), lambda: START_NS + 5 * FRAME_NS, late_ns=100_000_000)
    source.set_focus(300)
    frame = source.read(None, 0.05)
    assert frame.t_ns - EXPOSURE_NS // 2 >= START_NS + 5 * FRAME_NS + 50_000_000
    assert notebook.asked[0][0] == frame.t_ns - 100_000_000  # what it shows, which is before the lens was told


def test_the_eye_is_at_the_pivot_and_looks_where_the_gimbal_points():
    pose = RobotPose(np.array([0.5, 0.5, 0.1]), matrix(quaternion(0, 0, math.pi / 2)), 30.0, 10.0)
    eye, elevation_rad = look(pose, (0.1, 0.0, 0.0))
    np.testing.assert_allclose(eye.position_m, (0.5, 0.6, 0.1), atol=1e-12)
    forward = (-math.sin(math.radians(30)) * math.cos(math.radians(10)), 0, math.sin(math.radians(10)))
    np.testing.assert_allclose(eye.rotation[[0, 2], 2], (forward[0], forward[2]), atol=1e-12)
    assert elevation_rad == pytest.approx(math.radians(10))
    assert eye.rotation[2, 1] < -0.9  # the image's down is the world's down
    ahead, _ = look(RobotPose(np.zeros(3), np.eye(3), 0.0, 0.0), (0.1, 0.0, 0.0))
    np.testing.assert_allclose(ahead.rotation[:, 0], (0, -1, 0), atol=1e-12)  # the image's right is the robot's right


def test_the_other_robot_is_seen_and_the_own_hull_is_not():
    source, notebook = camera(filled(100), lambda: START_NS)
    source.read(None, 0.0)
    (hull,) = notebook.frames[0][2]
    np.testing.assert_allclose(hull.position_m, (1.0, 0.8, 0.1))


def test_a_read_waits_for_the_water_and_ends_with_it():
    history = filled(1)
    source, _ = camera(history, lambda: START_NS)
    got = []

    def read():
        try:
            got.append(source.read(None, 0.0).seq)
            got.append(source.read(None, 5.0))
        except CameraGone as error:
            got.append(str(error))

    thread = threading.Thread(target=read)
    thread.start()
    until(lambda: history._awaited_ns < math.inf)  # it waits
    assert got == []
    history.append(states(0.0))
    until(lambda: got)
    assert got == [0]
    history.close()
    thread.join(5)
    assert got == [0, "the twin has ended; start it again"]
