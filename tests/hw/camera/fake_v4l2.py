"""A computer with V4L2 cameras, faked below the system calls and in virtual time.

The sensor runs freely. A frame shows where the lens was when its exposure began, and lands in the buffer that was
queued first, or nowhere. What is not true of every driver can be changed by the tests.
"""

import errno
import struct

import cv2
import numpy as np

from hw.camera import v4l2_node as v4l2
from hw.camera.v4l2 import MJPG, YUYV, open_v4l2
from hw.camera.v4l2_node import System

FRAME_NS = 33_000_000
CALL_NS = 10_000  # what a system call takes
PAGE = 1 << 16
ELSEWHERE_NS = 1_700_000_000_000_000_000  # a stamp of the wall clock

# flags of a buffer, by who stamps it and when
STAMPS = {"start": 0x1_2000, "end": 0x2000, "unknown": 0x0, "copy": 0x4000}


def scene(lens_position):
    y, x = np.mgrid[0:64, 0:96]
    return np.stack([x + y, 2 * x + 20, np.full_like(x, 8 * lens_position)], axis=2).astype(np.uint8)


class Clock:
    def __init__(self):
        self.now_ns = 5_000_000_000

    def __call__(self):
        return self.now_ns


class FakeCamera:
    card, bus = "Deep Webcam", "usb-0000:00:14.0-1"

    def __init__(self, path="/dev/video7", clock=None):
        self.path = path
        self.clock = clock or Clock()
        self.capabilities = v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_STREAMING
        self.formats = {YUYV: {(96, 64): 30, (1280, 960): 5}, MJPG: {(96, 64): 30, (1280, 960): 30}}  # frames/s
        self.padding = 0  # bytes at the end of a row
        self.late_ns = 0  # how far its clock lags behind ours
        self.stamps = "start"
        self.again = 0  # times that DQBUF finds nothing although something was announced
        self.damage = []  # flags, or callables from bytes to bytes, for the next frames
        self.silent = self.unplugged = self.in_use = self.forbidden = False
        self.views = []  # of the buffers, handed out
        self.boot()

    def boot(self):
        """The state in which it comes out of its box: all automatics on."""
        self.controls = {  # id: lowest, highest, step, value
            v4l2.FOCUS_AUTO: [0, 1, 1, 1],
            v4l2.FOCUS_ABSOLUTE: [0, 20, 5, 3],
            v4l2.EXPOSURE_AUTO: [0, 3, 1, 3],
            v4l2.EXPOSURE_ABSOLUTE: [1, 2000, 1, 40],
            v4l2.EXPOSURE_AUTO_PRIORITY: [0, 1, 1, 1],
            v4l2.AUTO_WHITE_BALANCE: [0, 1, 1, 1],
            v4l2.WHITE_BALANCE_TEMPERATURE: [2000, 8000, 1, 5000],
            v4l2.SHARPNESS: [1, 9, 1, 5],
        }
        self.written = []  # (control, value) in order
        self.moves = [(0, 3)]  # of the lens
        self.fourcc, self.size, self.hz = YUYV, (96, 64), 30
        self.streaming = self.opened = False
        self.queued, self.filled, self.memory = [], [], []
        self.exposing_ns = self.clock.now_ns  # when the frame that is under way began

    def value(self, control):
        return self.controls[control][3]

    # --- the calls ------------------------------------------------------------------------------------------------

    def ioctl(self, request, argument):
        self.clock.now_ns += CALL_NS
        self.expose()
        if self.unplugged:
            raise OSError(errno.ENODEV, "No such device")
        calls = {
            v4l2.QUERYCAP: self.tell_capabilities,
            v4l2.G_FMT: self.tell_format,
            v4l2.S_FMT: self.set_format,
            v4l2.S_PARM: self.set_rate,
            v4l2.REQBUFS: self.give_buffers,
            v4l2.QUERYBUF: self.tell_buffer,
            v4l2.QBUF: self.queue,
            v4l2.DQBUF: self.dequeue,
            v4l2.STREAMON: self.stream_on,
            v4l2.STREAMOFF: self.stream_off,
            v4l2.QUERYCTRL: self.tell_control,
            v4l2.G_CTRL: self.tell_value,
            v4l2.S_CTRL: self.set_value,
        }
        if request not in calls:
            raise OSError(errno.ENOTTY, "Inappropriate ioctl for device")
        calls[request](argument)

    def map(self, offset, length):
        view = memoryview(self.memory[offset // PAGE])[:length]
        self.views.append(view)
        return view

    def wait(self, timeout_s):
        self.expose()
        if self.filled or self.unplugged:
            return True
        until_ns = self.clock.now_ns + round(timeout_s * 1e9)
        if self.streaming and self.queued and not self.silent:
            self.clock.now_ns = min(until_ns, self.exposing_ns + FRAME_NS)
        else:
            self.clock.now_ns = until_ns
        self.expose()
        return bool(self.filled)

    def close(self):
        self.opened = self.streaming = False
        self.queued, self.filled = [], []

    # --- the driver -----------------------------------------------------------------------------------------------

    def tell_capabilities(self, argument):
        node = self.capabilities
        whole = node | v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_DEVICE_CAPS
        struct.pack_into("16s32s32s3I", argument, 0, b"fake", self.card.encode(), self.bus.encode(), 1, whole, node)

    def tell_format(self, argument):
        stride = 2 * self.size[0] + self.padding
        struct.pack_into("6I", argument, 8, *self.size, self.fourcc, 1, stride, stride * self.size[1])

    def set_format(self, argument):
        if self.in_use:
            raise OSError(errno.EBUSY, "Device or resource busy")
        width, height, fourcc = struct.unpack_from("3I", argument, 8)
        self.fourcc = fourcc if fourcc in self.formats else next(iter(self.formats))
        sizes = self.formats[self.fourcc]
        self.size = min(sizes, key=lambda size: abs(size[0] - width) + abs(size[1] - height))
        self.hz = sizes[self.size]
        self.tell_format(argument)

    def set_rate(self, argument):
        struct.pack_into("2I", argument, 12, 1, self.hz)

    def give_buffers(self, argument):
        if self.in_use:
            raise OSError(errno.EBUSY, "Device or resource busy")
        count = struct.unpack_from("I", argument)[0]
        self.memory = [bytearray(PAGE) for _ in range(count)]

    def tell_buffer(self, argument):
        struct.pack_into("Q", argument, 64, struct.unpack_from("I", argument)[0] * PAGE)
        struct.pack_into("I", argument, 72, PAGE)

    def queue(self, argument):
        self.queued.append(struct.unpack_from("I", argument)[0])

    def dequeue(self, argument):
        if self.again or not self.filled:
            self.again = max(0, self.again - 1)
            raise OSError(errno.EAGAIN, "Resource temporarily unavailable")
        index, count, flags, stamp_ns = self.filled.pop(0)
        struct.pack_into("5I", argument, 0, index, v4l2.BUF_TYPE_VIDEO_CAPTURE, count, flags, 1)
        struct.pack_into("2q", argument, 24, stamp_ns // 10**9, stamp_ns % 10**9 // 1000)

    def stream_on(self, argument):
        self.streaming, self.exposing_ns = True, self.clock.now_ns

    def stream_off(self, argument):
        self.streaming = False

    def which(self, argument):
        control = struct.unpack_from("I", argument)[0]
        if control not in self.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        return control

    def tell_control(self, argument):
        control = self.which(argument)
        lowest, highest, step, _ = self.controls[control]
        argument[:] = struct.pack("=II32s4iI2I", control, 1, b"name", lowest, highest, step, lowest, 0, 0, 0)

    def tell_value(self, argument):
        struct.pack_into("=i", argument, 4, self.value(self.which(argument)))

    def set_value(self, argument):
        control, wanted = self.which(argument), struct.unpack_from("=i", argument, 4)[0]
        lowest, highest, *_ = self.controls[control]
        if control == v4l2.FOCUS_ABSOLUTE and v4l2.FOCUS_AUTO in self.controls and self.value(v4l2.FOCUS_AUTO):
            raise OSError(errno.EACCES, "Permission denied")
        self.written.append((control, wanted))
        self.controls[control][3] = min(max(wanted, lowest), highest)
        if control == v4l2.FOCUS_ABSOLUTE:
            self.moves.append((self.clock.now_ns, self.value(control)))

    # --- the sensor -----------------------------------------------------------------------------------------------

    def expose(self):
        """All frames that are done by now."""
        while self.exposing_ns + FRAME_NS <= self.clock.now_ns:
            began_ns, self.exposing_ns = self.exposing_ns, self.exposing_ns + FRAME_NS
            automatic = self.controls.get(v4l2.EXPOSURE_AUTO)
            if automatic and automatic[3] != v4l2.EXPOSURE_MANUAL:
                self.controls[v4l2.EXPOSURE_ABSOLUTE][3] = 100
            if self.streaming and self.queued and not self.silent and not self.unplugged:
                self.fill(self.queued.pop(0), began_ns)

    def fill(self, index, began_ns):
        lens_position = next(p for t_ns, p in reversed(self.moves) if t_ns <= began_ns)
        data, flags = self.encoded(scene(lens_position)), STAMPS[self.stamps]
        stamp_ns = {"start": began_ns, "end": began_ns + FRAME_NS}.get(
            self.stamps, ELSEWHERE_NS + began_ns
        ) - self.late_ns
        damage = self.damage.pop(0) if self.damage else 0
        if callable(damage):
            data = damage(data)
        else:
            flags |= damage
        self.memory[index][: len(data)] = data
        self.filled.append((index, len(data), flags, stamp_ns))

    def encoded(self, image):
        if self.fourcc == MJPG:
            return cv2.imencode(".jpg", image)[1].tobytes()
        rows = cv2.cvtColor(image, cv2.COLOR_BGR2YUV_YUYV).reshape(image.shape[0], -1)
        return np.pad(rows, ((0, 0), (0, self.padding))).tobytes()


class FakeComputer:
    """Nodes by path; one camera that works, to begin with."""

    def __init__(self):
        self.clock = Clock()
        self.camera = FakeCamera(clock=self.clock)
        self.there = {self.camera.path: self.camera}
        self.system = System(lambda: list(self.there), self.attach)

    def attach(self, path):
        if path not in self.there:
            raise OSError(errno.ENOENT, "No such file or directory")
        if self.there[path].forbidden:
            raise PermissionError(errno.EACCES, "Permission denied")
        self.there[path].opened = True
        return self.there[path]

    def open(self, place=FakeCamera.card, size=(96, 64)):
        return open_v4l2(place, size, self.system, self.clock)

    def pull(self):
        self.camera.unplugged = True
        del self.there[self.camera.path]

    def plug(self, path="/dev/video9"):
        """Come back as another device, on another node."""
        self.camera = FakeCamera(path, self.clock)
        self.there[path] = self.camera


def through_yuyv(image):
    """What is left of a picture after its colours were halved across."""
    return cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BGR2YUV_YUYV), cv2.COLOR_YUV2BGR_YUYV)
