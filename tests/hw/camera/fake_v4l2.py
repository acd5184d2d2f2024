"""A computer with V4L2 cameras, faked below the system calls and in virtual time.

The sensor runs freely. A frame shows where the lens was when its exposure began, and lands in the buffer that was
queued first, or nowhere. What is not true of every driver can be changed by the tests.
"""

import ctypes
import errno
import struct

import cv2
import numpy as np

from hw.camera import v4l2_node as v4l2
from hw.camera.v4l2 import open_v4l2
from hw.camera.v4l2_node import MJPG, NV12, UYVY, YUYV, System

FRAME_NS = 33_000_000
CALL_NS = 10_000  # what a system call takes
PAGE = 1 << 16
LIGHT = 100  # exposure, in units of 100 us, in which the scene is as bright as drawn
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


def fourcc(name):
    return int.from_bytes(name.encode(), "little")


DESCRIPTIONS = {fourcc("RG10"): b"10-bit Bayer RGRG/GBGB", fourcc("H264"): b"H.264"}
COMPRESSED = (MJPG, fourcc("H264"))


class FakeCamera:
    driver = "fake"
    card, bus = "Deep Webcam", "usb-0000:00:14.0-1"

    def __init__(self, path="/dev/video7", clock=None):
        self.path = path
        self.clock = clock or Clock()
        self.capabilities = v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_STREAMING
        self.formats = {YUYV: {(96, 64): 30, (1280, 960): 5}, MJPG: {(96, 64): 30, (1280, 960): 30}}  # frames/s
        self.strict = False  # it refuses formats that it does not have, and takes no other in their place
        self.ranges = False  # its sizes are ranges
        self.planes = False  # its queue is multi-planar
        self.padding = 0  # bytes at the end of a row
        self.hold = 0  # frames that it keeps before it sends them
        self.menus = {}  # control: entries
        self.failing = set()  # controls whose every call ends in EIO
        self.tells_exposure = True  # what its automatic has found can be read
        self.shows_exposure = False  # in how bright its pictures are
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
            v4l2.POWER_LINE_FREQUENCY: [0, 2, 1, 0],
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
        self.kept = []  # when the frames began that it has not sent yet
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
            v4l2.ENUM_FMT: self.offer_format,
            v4l2.ENUM_FRAMESIZES: self.offer_size,
            v4l2.ENUM_FRAMEINTERVALS: self.offer_rate,
            v4l2.QUERYMENU: self.tell_entry,
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
        if self.planes:
            node = node & ~v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_VIDEO_CAPTURE_MPLANE
        whole = node | v4l2.CAP_VIDEO_CAPTURE | v4l2.CAP_DEVICE_CAPS
        names = self.driver.encode(), self.card.encode(), self.bus.encode()
        struct.pack_into("16s32s32s3I", argument, 0, *names, 1, whole, node)

    def check_queue(self, argument, at):
        if struct.unpack_from("I", argument, at)[0] != (9 if self.planes else 1):
            raise OSError(errno.EINVAL, "Invalid argument")

    def offer_format(self, argument):
        self.check_queue(argument, 4)
        kind = self.entry(list(self.formats), argument, 0)
        text = DESCRIPTIONS.get(kind, b"some format")
        struct.pack_into("I32sI", argument, 8, int(kind in COMPRESSED), text, kind)

    def offer_size(self, argument):
        sizes = self.formats.get(struct.unpack_from("I", argument, 4)[0], {})
        width, height = self.entry(list(sizes), argument, 0)
        if self.ranges:
            struct.pack_into("7I", argument, 8, 3, width, 4096, 2, height, 4096, 2)
        else:
            struct.pack_into("3I", argument, 8, v4l2.DISCRETE, width, height)

    def offer_rate(self, argument):
        kind, *size = struct.unpack_from("3I", argument, 4)
        hz = self.entry([self.formats[kind][tuple(size)]], argument, 0)
        struct.pack_into("3I", argument, 16, v4l2.DISCRETE, 1, hz)

    def tell_entry(self, argument):
        menu = self.menus.get(self.which(argument), {})
        index = struct.unpack_from("I", argument, 4)[0]
        if index not in menu:
            raise OSError(errno.EINVAL, "Invalid argument")
        struct.pack_into("32s", argument, 8, menu[index].encode())

    def entry(self, entries, argument, at):
        index = struct.unpack_from("I", argument, at)[0]
        if index >= len(entries):
            raise OSError(errno.EINVAL, "Invalid argument")
        return entries[index]

    def tell_format(self, argument):
        self.check_queue(argument, 0)
        stride = (1 if self.fourcc == NV12 else 2) * self.size[0] + self.padding
        size = stride * self.size[1]
        after = (8, size, stride) if self.planes else (stride, size, 8)
        struct.pack_into("7I", argument, 8, *self.size, self.fourcc, 1, *after)

    def set_format(self, argument):
        if self.in_use:
            raise OSError(errno.EBUSY, "Device or resource busy")
        width, height, kind = struct.unpack_from("3I", argument, 8)
        if self.strict and kind not in self.formats:
            raise OSError(errno.EINVAL, "Invalid argument")
        self.fourcc = kind if kind in self.formats else next(iter(self.formats))
        sizes = self.formats[self.fourcc]
        self.size = min(sizes, key=lambda size: abs(size[0] - width) + abs(size[1] - height))
        self.hz = sizes[self.size]
        self.tell_format(argument)

    def set_rate(self, argument):
        struct.pack_into("2I", argument, 12, 1, self.hz)

    def give_buffers(self, argument):
        if self.in_use:
            raise OSError(errno.EBUSY, "Device or resource busy")
        self.check_queue(argument, 4)
        count = struct.unpack_from("I", argument)[0]
        self.memory = [bytearray(PAGE) for _ in range(count)]

    def tell_buffer(self, argument):
        self.check_queue(argument, 4)
        offset = struct.unpack_from("I", argument)[0] * PAGE
        if self.planes:
            self.write_plane(argument, struct.pack("IIQ", 0, PAGE, offset))
        else:
            struct.pack_into("QI", argument, 64, offset, PAGE)

    def write_plane(self, argument, data):
        """Through the pointer that a multi-planar buffer is told by."""
        address, count = struct.unpack_from("QI", argument, 64)
        assert count == 1
        ctypes.memmove(address, data, len(data))

    def queue(self, argument):
        self.check_queue(argument, 4)
        self.queued.append(struct.unpack_from("I", argument)[0])

    def dequeue(self, argument):
        if self.again or not self.filled:
            self.again = max(0, self.again - 1)
            raise OSError(errno.EAGAIN, "Resource temporarily unavailable")
        index, count, flags, stamp_ns = self.filled.pop(0)
        struct.pack_into("5I", argument, 0, index, 9 if self.planes else 1, 0 if self.planes else count, flags, 1)
        struct.pack_into("2q", argument, 24, stamp_ns // 10**9, stamp_ns % 10**9 // 1000)
        if self.planes:
            self.write_plane(argument, struct.pack("IIQ", count, PAGE, index * PAGE))

    def stream_on(self, argument):
        self.streaming, self.exposing_ns = True, self.clock.now_ns

    def stream_off(self, argument):
        self.streaming = False

    def which(self, argument):
        control = struct.unpack_from("I", argument)[0]
        if control not in self.controls:
            raise OSError(errno.EINVAL, "Invalid argument")
        if control in self.failing:
            raise OSError(errno.EIO, "Input/output error")
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
            self.kept.append((self.exposing_ns, self.brightness()))
            self.exposing_ns += FRAME_NS
            if self.automatic and self.tells_exposure:
                self.controls[v4l2.EXPOSURE_ABSOLUTE][3] = LIGHT
            if len(self.kept) > self.hold:
                frame = self.kept.pop(0)
                if self.streaming and self.queued and not self.silent and not self.unplugged:
                    self.fill(self.queued.pop(0), *frame)

    @property
    def automatic(self):
        known = self.controls.get(v4l2.EXPOSURE_AUTO)
        return known is not None and known[3] not in (v4l2.EXPOSURE_MANUAL, v4l2.EXPOSURE_SHUTTER_PRIORITY)

    def brightness(self):
        """Of the frame that is under way, in times of what is drawn."""
        if not self.shows_exposure or self.automatic:
            return 1.0
        return self.controls[v4l2.EXPOSURE_ABSOLUTE][3] / LIGHT

    def fill(self, index, began_ns, times):
        lens_position = next(p for t_ns, p in reversed(self.moves) if t_ns <= began_ns)
        image = (np.clip(scene(lens_position) * times, 0, 255)).astype(np.uint8)
        data, flags = self.encoded(image), STAMPS[self.stamps]
        if self.driver == "uvcvideo":  # the first packet, whatever the flags say
            stamp_ns = began_ns + self.controls[v4l2.EXPOSURE_ABSOLUTE][3] * 100_000 + self.hold * FRAME_NS
        else:
            known = {"start": began_ns, "end": began_ns + FRAME_NS}
            stamp_ns = known.get(self.stamps, ELSEWHERE_NS + began_ns)
        damage = self.damage.pop(0) if self.damage else 0
        if callable(damage):
            data = damage(data)
        else:
            flags |= damage
        self.memory[index][: len(data)] = data
        self.filled.append((index, len(data), flags, stamp_ns - self.late_ns))

    def encoded(self, image):
        if self.fourcc == MJPG:
            return cv2.imencode(".jpg", image)[1].tobytes()
        if self.fourcc == NV12:
            planar = cv2.cvtColor(image, cv2.COLOR_BGR2YUV_I420)
            height, width = image.shape[:2]
            u, v = planar[height:].reshape(2, -1)
            rows = np.vstack([planar[:height], np.stack([u, v], axis=1).reshape(-1, width)])
        else:
            pairs = cv2.cvtColor(image, cv2.COLOR_BGR2YUV_YUYV)
            rows = (pairs[..., ::-1] if self.fourcc == UYVY else pairs).reshape(image.shape[0], -1)
        return np.pad(rows, ((0, 0), (0, self.padding))).tobytes()


class FakeComputer:
    """Nodes by path; one camera that works, to begin with."""

    def __init__(self):
        self.clock = Clock()
        self.camera = FakeCamera(clock=self.clock)
        self.there = {self.camera.path: self.camera}
        self.hardware_stamps = False
        self.system = System(lambda: list(self.there), self.attach, lambda: self.hardware_stamps)

    def attach(self, path):
        if path not in self.there:
            raise OSError(errno.ENOENT, "No such file or directory")
        if self.there[path].forbidden:
            raise PermissionError(errno.EACCES, "Permission denied")
        self.there[path].opened = True
        return self.there[path]

    def open(self, place=FakeCamera.card, size=(96, 64), mains_hz=50):
        return open_v4l2(place, size, mains_hz, self.system, self.clock)

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
