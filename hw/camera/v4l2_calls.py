"""What is said to a Video4Linux driver: numbers and structs of linux/videodev2.h and linux/v4l2-controls.h.

Numbers have their names there, without V4L2_ and CID_.
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

CAP_VIDEO_CAPTURE, CAP_STREAMING, CAP_DEVICE_CAPS = 0x1, 0x0400_0000, 0x8000_0000  # capabilities
BUF_TYPE_VIDEO_CAPTURE = 1
MEMORY_MMAP = 1
FIELD_NONE = 1  # progressive

# flags of a buffer
BUF_FLAG_ERROR = 0x40  # the bytes may be wrong, the next buffer will be right again
BUF_FLAG_TIMESTAMP_MASK, BUF_FLAG_TIMESTAMP_MONOTONIC = 0xE000, 0x2000  # else unknown, or copied from elsewhere
BUF_FLAG_TSTAMP_SRC_MASK = 0x7_0000
BUF_FLAG_TSTAMP_SRC_SOE = 0x1_0000  # stamped at the start of the exposure; else when the last byte had come

# flags of a control
UNUSABLE = 0x0001 | 0x0004  # DISABLED, READ_ONLY

AUTO_WHITE_BALANCE, WHITE_BALANCE_TEMPERATURE = 0x0098_090C, 0x0098_091A  # the latter in kelvin
AUTOGAIN, GAIN = 0x0098_0912, 0x0098_0913
SHARPNESS = 0x0098_091B
EXPOSURE_AUTO, EXPOSURE_ABSOLUTE = 0x009A_0901, 0x009A_0902  # the latter in units of 100 us
EXPOSURE_AUTO_PRIORITY = 0x009A_0903  # the exposure may slow the frames down
FOCUS_ABSOLUTE, FOCUS_AUTO = 0x009A_090A, 0x009A_090C
EXPOSURE_MANUAL = 1  # 0 would be automatic


class Device(Protocol):
    """One open video node, real (hw.camera.v4l2_node) or not."""

    path: str

    def ioctl(self, request: int, argument: bytearray) -> None:
        """Raises OSError."""

    def map(self, offset: int, length: int) -> memoryview:
        """The memory of one of the driver's buffers."""

    def wait(self, timeout_s: float) -> bool:
        """Wait until a buffer is filled, or the device has something else to say; False if nothing came in time."""

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
    can = node if whole & CAP_DEVICE_CAPS else whole
    return Identity(_text(card), _text(bus), can & CAP_VIDEO_CAPTURE != 0 and can & CAP_STREAMING != 0)


def _text(raw: bytes) -> str:
    return raw.split(b"\0", 1)[0].decode(errors="replace")
