"""What stands in for the devices: a frame source behind the camera socket, a driver behind the V4L2 calls, files.

All of them show the same scene, 96x64 pixels, whose picture tells the lens position: `scene(position)`.
"""

import contextlib
import errno
import struct
import threading
import time

import cv2
import numpy as np
import pytest

from hw import camera_v4l2 as v4l2
from hw.camera import CameraError, FocusRange, Frame, Roi

SIZE = (96, 64)


def scene(position):
    y, x = np.mgrid[0:64, 0:96]
    return np.stack([x + y, 2 * x + 20, np.full_like(x, 8 * position)], axis=2).astype(np.uint8)


class Source:
    """A camera as the twin sees it; `gate` holds back the frames, `fault` is raised instead of one."""

    size = SIZE
    focus_range = FocusRange(0, 20, 2)

    def __init__(self):
        self.position = 0
        self.seq = 0
        self.settles_s = []
        self.rois = []
        self.gate = threading.Event()
        self.gate.set()
        self.fault = None

    def set_focus(self, position):
        self.position = position
        return position

    def read(self, roi, settle_s):
        self.gate.wait()
        if self.fault:
            raise CameraError(self.fault)
        self.rois.append(roi)
        self.settles_s.append(settle_s)
        self.seq += 1
        part = roi or Roi(0, 0, *SIZE)
        image = scene(self.position)[part.y : part.y + part.height, part.x : part.x + part.width]
        return Frame(time.monotonic_ns(), self.seq, image, part)


class Driver:
    """A UVC camera seen through ioctl and a capture object, on a clock of its own that each frame moves on.

    One frame always waits in the queue, exposed before it was asked for. The automatic exposure and the autofocus
    move their values as long as they are on.
    """

    FRAME_NS = 33_000_000

    def __init__(self):
        self.now_ns = 5_000_000_000
        self.queued_ns = self.now_ns - self.FRAME_NS
        self.stamp_ns = 0
        self.controls = {  # id: lowest, highest, step, value
            v4l2.FOCUS_AUTO: [0, 1, 1, 1],
            v4l2.FOCUS_ABSOLUTE: [0, 20, 5, 3],
            v4l2.EXPOSURE_AUTO: [0, 3, 1, 3],
            v4l2.EXPOSURE_100US: [1, 2000, 1, 40],
            v4l2.WHITE_BALANCE_AUTO: [0, 1, 1, 1],
            v4l2.WHITE_BALANCE_K: [2000, 8000, 1, 5000],
            v4l2.SHARPNESS: [1, 9, 1, 5],
        }
        self.properties = {cv2.CAP_PROP_FRAME_WIDTH: SIZE[0], cv2.CAP_PROP_FRAME_HEIGHT: SIZE[1]}
        self.written = []  # (control, value) in order
        self.unplugged = False
        self.released = False

    def value(self, control):
        return self.controls[control][3]

    def ioctl(self, request, argument):
        if self.unplugged:
            raise OSError(errno.ENODEV, "No such device")
        control = struct.unpack_from("=I", argument)[0]
        if control not in self.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        lowest, highest, step, value = self.controls[control]
        if request == v4l2.VIDIOC_QUERYCTRL:
            argument[:] = struct.pack("=II32s4iI2I", control, 1, b"name", lowest, highest, step, lowest, 0, 0, 0)
        elif request == v4l2.VIDIOC_G_CTRL:
            struct.pack_into("=i", argument, 4, value)
        elif request == v4l2.VIDIOC_S_CTRL:
            wanted = struct.unpack_from("=i", argument, 4)[0]
            if control == v4l2.FOCUS_ABSOLUTE and v4l2.FOCUS_AUTO in self.controls and self.value(v4l2.FOCUS_AUTO):
                raise OSError(errno.EACCES, "Permission denied")
            self.written.append((control, wanted))
            self.controls[control][3] = min(max(wanted, lowest), highest)
        else:
            raise OSError(errno.ENOTTY, "Inappropriate ioctl for device")

    def read(self):
        if self.unplugged:
            return False, None
        self.stamp_ns, self.queued_ns = self.queued_ns, self.now_ns
        self.now_ns += self.FRAME_NS
        if self.value(v4l2.EXPOSURE_AUTO) != v4l2.EXPOSURE_MANUAL:
            self.controls[v4l2.EXPOSURE_100US][3] = 100
        return True, scene(self.value(v4l2.FOCUS_ABSOLUTE) if v4l2.FOCUS_ABSOLUTE in self.controls else 0)

    def get(self, prop):
        return self.stamp_ns * 1e-6 if prop == cv2.CAP_PROP_POS_MSEC else self.properties.get(prop, 0.0)

    def set(self, prop, value):
        self.properties[prop] = value
        return True

    def release(self):
        self.released = True

    def camera(self, size=None):
        camera = v4l2.V4l2Camera("/dev/video7", self.ioctl, self, lambda: self.now_ns, lambda: None)
        camera.prepare(size)
        return camera


@pytest.fixture
def source():
    made = Source()
    yield made
    made.gate.set()


@pytest.fixture
def driver():
    return Driver()


@pytest.fixture
def picture():
    """position -> the scene at that position."""
    return scene


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
