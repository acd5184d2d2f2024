"""What is said to a Video4Linux driver: numbers and structs of linux/videodev2.h and linux/v4l2-controls.h.

A `Device` is one open node. Requests go through `ioctl`, whose argument is a struct that the driver reads and writes.
Structs are in the machine's own layout (struct's "@"), as the kernel reads them.
"""

from __future__ import annotations

import struct
from typing import NamedTuple, Protocol

CAPABILITY = struct.Struct("@16s32s32s3I12x")  # driver card bus_info version capabilities device_caps
FORMAT = struct.Struct("@I0L12I152x")  # type; width height fourcc field bytesperline sizeimage colorspace priv flags 3*
STREAM_PARAMETERS = struct.Struct("@7I176x")  # type capability mode, period: numerator denominator, mode buffers
REQUEST_BUFFERS = struct.Struct("@4I4x")  # count type memory capabilities
BUFFER = struct.Struct("@5I2l16s2IL3I0L")  # index type bytes flags field, s us, timecode, seq memory offset length 2*
BUFFER_TYPE = struct.Struct("@I")
QUERY_CONTROL = struct.Struct("@2I32s4i3I")  # id type name lowest highest step default flags reserved 2*
CONTROL = struct.Struct("@Ii")  # id value


def _number(way: int, nr: int, layout: struct.Struct) -> int:
    """_IOC of asm-generic/ioctl.h: direction, size of the argument, type 'V', number."""
    return way << 30 | layout.size << 16 | ord("V") << 8 | nr


_WRITE, _READ, _BOTH = 1, 2, 3
QUERYCAP = _number(_READ, 0, CAPABILITY)
G_FMT, S_FMT = _number(_BOTH, 4, FORMAT), _number(_BOTH, 5, FORMAT)
REQBUFS = _number(_BOTH, 8, REQUEST_BUFFERS)
QUERYBUF, QBUF, DQBUF = (_number(_BOTH, nr, BUFFER) for nr in (9, 15, 17))
STREAMON, STREAMOFF = (_number(_WRITE, nr, BUFFER_TYPE) for nr in (18, 19))
S_PARM = _number(_BOTH, 22, STREAM_PARAMETERS)
G_CTRL, S_CTRL = _number(_BOTH, 27, CONTROL), _number(_BOTH, 28, CONTROL)
QUERYCTRL = _number(_BOTH, 36, QUERY_CONTROL)

CAN_CAPTURE, CAN_STREAM, HAS_DEVICE_CAPS = 0x1, 0x0400_0000, 0x8000_0000  # capabilities
VIDEO_CAPTURE = 1  # V4L2_BUF_TYPE_VIDEO_CAPTURE
MEMORY_MMAP = 1
FIELD_NONE = 1  # progressive

# flags of a buffer
DAMAGED = 0x40  # V4L2_BUF_FLAG_ERROR: the bytes may be wrong, the next buffer will be right again
CLOCK_MASK, CLOCK_MONOTONIC = 0xE000, 0x2000  # else unknown, or copied from elsewhere
TAKEN_MASK, TAKEN_AT_START = 0x7_0000, 0x1_0000  # of the exposure; else when the last byte had come

# flags of a control
UNUSABLE = 0x0001 | 0x0004  # DISABLED, READ_ONLY

WHITE_BALANCE_AUTO, WHITE_BALANCE_K = 0x0098_090C, 0x0098_091A
GAIN_AUTO, GAIN = 0x0098_0912, 0x0098_0913
SHARPNESS = 0x0098_091B
EXPOSURE_AUTO, EXPOSURE_100US, EXPOSURE_MAY_SLOW = 0x009A_0901, 0x009A_0902, 0x009A_0903
FOCUS_ABSOLUTE, FOCUS_AUTO = 0x009A_090A, 0x009A_090C
EXPOSURE_MANUAL = 1  # V4L2_EXPOSURE_MANUAL; 0 would be automatic


class Device(Protocol):
    """One open video node, real (hw.v4l2_node) or not."""

    path: str

    def ioctl(self, request: int, argument: bytearray) -> None:
        """Raises OSError."""

    def map(self, offset: int, length: int) -> memoryview:
        """The memory of one of the driver's buffers."""

    def wait(self, timeout_s: float) -> bool:
        """Until a buffer is filled, or the device has something else to say; False if nothing came in time."""

    def close(self) -> None: ...


class Identity(NamedTuple):
    """What a camera says of itself."""

    card: str  # its name
    bus: str  # the port that it is plugged into
    captures: bool  # delivers pictures; a webcam's second node delivers only what is known about them


def identity(device: Device) -> Identity:
    """Raises OSError, ENOTTY for a node that is no Video4Linux device."""
    argument = bytearray(CAPABILITY.size)
    device.ioctl(QUERYCAP, argument)
    _, card, bus, _, whole, node = CAPABILITY.unpack(argument)
    can = node if whole & HAS_DEVICE_CAPS else whole
    return Identity(_text(card), _text(bus), can & CAN_CAPTURE != 0 and can & CAN_STREAM != 0)


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode(errors="replace")
