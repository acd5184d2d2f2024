"""What stands in for the devices: a frame source behind the camera socket, files, a computer of fake_v4l2, and one of
fake_picamera2.

All of them show the same scene, 96x64 pixels, whose picture tells the lens position: `scene(lens_position)`.
"""

import contextlib
import sys
import threading
import time
from types import SimpleNamespace

import cv2
import pytest

from hw.camera.camera import CameraError, FocusRange, Frame, Roi
from tests.hw.camera.fake_picamera2 import FakePi
from tests.hw.camera.fake_v4l2 import FakeComputer, scene

SIZE = (96, 64)


class Source:
    """A camera as the twin sees it; `gate` holds back the frames, `fault` is raised instead of one."""

    size = SIZE
    focus_range = FocusRange(0, 20, 2)

    def __init__(self):
        self.lens_position = 0
        self.seq = 0
        self.settles_s = []
        self.rois = []
        self.gate = threading.Event()
        self.gate.set()
        self.fault = None

    def set_focus(self, lens_position):
        self.lens_position = lens_position
        return lens_position

    def read(self, roi, settle_s):
        self.gate.wait()
        if self.fault:
            raise CameraError(self.fault)
        self.rois.append(roi)
        self.settles_s.append(settle_s)
        self.seq += 1
        part = roi or Roi(0, 0, *SIZE)
        image = scene(self.lens_position)[part.y : part.y + part.height, part.x : part.x + part.width]
        return Frame(time.monotonic_ns(), self.seq, image, part)


@pytest.fixture
def source():
    made = Source()
    yield made
    made.gate.set()


@pytest.fixture
def stack(tmp_path):
    """Five photographs, listed from far to near although positions.csv may come in any order."""
    directory = tmp_path / "stack"
    directory.mkdir()
    rows = ["file,focus_position"]
    for index in (4, 0, 3, 1, 2):
        cv2.imwrite(str(directory / f"{index}.png"), scene(index))
        rows.append(f"{index}.png,{-0.2 + 0.1 * index:.1f}")
    (directory / "positions.csv").write_text("\n".join(rows) + "\n")
    return directory


@pytest.fixture
def video(tmp_path):
    """Eight equal frames at 25 frames/s."""
    path = tmp_path / "dive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, SIZE)
    for _ in range(8):
        writer.write(scene(3))
    writer.release()
    return path


@pytest.fixture
def closing():
    """Closes everything handed to it, the last one first."""
    with contextlib.ExitStack() as stack:
        yield lambda thing: stack.enter_context(contextlib.closing(thing))


@pytest.fixture
def computer():
    return FakeComputer()


@pytest.fixture
def pi(monkeypatch):
    made = FakePi()
    monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=made))
    return made


@pytest.fixture
def device(computer):
    return computer.camera
