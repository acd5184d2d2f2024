"""The camera socket of the twin: what travels on it.

AF_UNIX stream. The client sends a request of fixed size; the server answers with a header of fixed size and then
`nbytes` of payload: pixels (READ), numbers (INFO, SET_FOCUS) or, with any status but OK, one line of text.
Integers are little-endian and CRC-32 (zlib's) covers all of a header before it. As with a real driver, nothing
tells where the lens truly is or what is in front of it.
"""

from __future__ import annotations

import socket
import struct
import zlib
from typing import NamedTuple

from agent.clock.clock import Clock
from hw.camera.camera import Roi

MAGIC = b"AUC1"

INFO, SET_FOCUS, READ = 1, 2, 3  # verbs
OK, FAILED, UNKNOWN_VERB, BUSY, TORN = range(5)  # status; after the last two the server hangs up

FULL = Roi(0, 0, 0, 0)  # asks for the whole frame

MAX_PAYLOAD = 64 << 20  # bytes; more is taken for a torn stream, not for a frame

_REQUEST = struct.Struct("<4sB3xIiI4H")  # magic, verb, id, lens position, settle us, x y width height
_REPLY = struct.Struct("<4sB3xIQQ4HI")  # magic, status, id, seq, middle of exposure ns, x y width height, nbytes
_CRC = struct.Struct("<I")
REQUEST_SIZE = _REQUEST.size + _CRC.size
REPLY_SIZE = _REPLY.size + _CRC.size

INFO_REPLY = struct.Struct("<2H3i")  # payload: width, height, lowest, highest, step
SET_FOCUS_REPLY = struct.Struct("<i")  # payload: the lens position that the driver reports


class Request(NamedTuple):
    verb: int
    id: int
    lens_position: int = 0
    settle_us: int = 0
    roi: Roi = FULL


class Reply(NamedTuple):
    status: int
    id: int
    seq: int = 0
    t_ns: int = 0
    roi: Roi = FULL
    nbytes: int = 0


class Torn(ValueError):
    """What was read is no header of this protocol: the stream cannot be trusted any more."""


def pack_request(request: Request) -> bytes:
    return _with_crc(
        _REQUEST.pack(MAGIC, request.verb, request.id, request.lens_position, request.settle_us, *request.roi)
    )


def parse_request(header: bytes) -> Request:
    """Raises Torn."""
    _, verb, number, lens_position, settle_us, *roi = _REQUEST.unpack(_checked(header))
    return Request(verb, number, lens_position, settle_us, Roi(*roi))


def pack_reply(reply: Reply) -> bytes:
    return _with_crc(_REPLY.pack(MAGIC, reply.status, reply.id, reply.seq, reply.t_ns, *reply.roi, reply.nbytes))


def parse_reply(header: bytes) -> Reply:
    """Raises Torn."""
    _, status, number, seq, t_ns, x, y, width, height, nbytes = _REPLY.unpack(_checked(header))
    if nbytes > MAX_PAYLOAD:
        raise Torn(f"payload of {nbytes} bytes announced, limit {MAX_PAYLOAD}")
    return Reply(status, number, seq, t_ns, Roi(x, y, width, height), nbytes)


def receive_into(connection: socket.socket, buffer: memoryview, clock: Clock, until_ns: int) -> None:
    """Fill `buffer`. Raises EOFError if the other side hangs up, TimeoutError when it is until_ns by the clock."""
    while buffer:
        left_s = clock.wall_s(until_ns)
        if left_s <= 0:
            raise TimeoutError
        connection.settimeout(left_s)
        try:
            count = connection.recv_into(buffer)
        except TimeoutError:
            continue  # the clock may have stood meanwhile
        if count == 0:
            raise EOFError
        buffer = buffer[count:]


def _with_crc(fields: bytes) -> bytes:
    return fields + _CRC.pack(zlib.crc32(fields))


def _checked(header: bytes) -> bytes:
    fields, seal = header[: -_CRC.size], header[-_CRC.size :]
    if not fields.startswith(MAGIC):
        raise Torn(f"begins with {fields[:4]!r}, not with {MAGIC!r}")
    if _CRC.unpack(seal)[0] != zlib.crc32(fields):
        raise Torn("checksum is wrong")
    return fields
