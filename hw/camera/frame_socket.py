"""The camera socket of the twin: its messages, the server inside the twin, and the camera at the other end.

AF_UNIX stream. The client sends a request of fixed size; the server answers with a header of fixed size and then
`nbytes` of payload: pixels (READ), numbers (INFO, SET_FOCUS) or, with any status but OK, one line of text.
Integers are little-endian and CRC-32 (zlib's) covers all of a header before it. As with a real driver, nothing
tells where the lens truly is or what is in front of it.
"""

from __future__ import annotations

import contextlib
import itertools
import select
import socket
import stat
import struct
import threading
import zlib
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from agent.clock.clock import Clock, SystemClock
from hw.camera.camera import PATIENCE_S, CameraError, CameraGone, FocusRange, Frame, Roi, Stamp, deliverable, nearest

# --- messages ---

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


# --- server ---

STALL_S = 2.0  # a client that stops in the middle of a message for longer is dropped


class FrameSource(Protocol):
    """What is served: a camera seen from inside the twin. Called from the server's thread only."""

    size: tuple[int, int]
    focus_range: FocusRange

    def set_focus(self, lens_position: int) -> int:
        """Move the lens; returns the lens position that a driver would report."""

    def read(self, roi: Roi | None, settle_s: float) -> Frame:
        """The first frame exposed after this call and `settle_s` after the last set_focus; waits for it."""


class FrameServer:
    """One camera on one socket, one client at a time, in one thread between start() and close()."""

    def __init__(self, path: Path, source: FrameSource) -> None:
        self.path = path
        self._source = source
        self._clock = SystemClock()  # a client that hangs is no event of a dive
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()

    def start(self) -> None:
        """Create the socket file, for this user only, and begin to serve. Raises CameraError."""
        self._listener = _listen(self.path)
        self._thread = threading.Thread(target=self._serve, args=(self._listener,), name=f"camera {self.path.name}")
        self._thread.start()

    def close(self) -> None:
        """Hang up and end the thread: at once, or when the frame that the source is exposing is done."""
        self._closing.set()
        for waited_for in (self._client, self._listener):
            if waited_for is not None:
                with contextlib.suppress(OSError):  # it may hang up by itself meanwhile
                    waited_for.shutdown(socket.SHUT_RDWR)
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _serve(self, listener: socket.socket) -> None:
        try:
            while not self._closing.is_set():
                watched = [listener] if self._client is None else [self._client, listener]
                for ready in select.select(watched, [], [])[0]:
                    if self._closing.is_set():
                        return
                    if ready is listener:
                        self._admit(listener)
                    elif not self._answer(ready):
                        self._drop()
        finally:
            self._drop()
            listener.close()
            self.path.unlink(missing_ok=True)

    def _admit(self, listener: socket.socket) -> None:
        """A client is served before the listener is looked at, so one that died is gone by now."""
        try:
            connection, _ = listener.accept()
        except OSError:  # it was shut down meanwhile
            return
        if self._client is None:
            self._client = connection
            return
        with connection, contextlib.suppress(OSError):
            _send(connection, Reply(BUSY, 0), b"this camera is in use; end the other program that reads it")

    def _drop(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            client.close()

    def _answer(self, client: socket.socket) -> bool:
        """Serve one request; False if the client is gone or has to go."""
        header = bytearray(REQUEST_SIZE)
        try:
            until_ns = self._clock.now_ns() + round(STALL_S * 1e9)
            receive_into(client, memoryview(header), self._clock, until_ns)
            reply, payload = self._reply(bytes(header))
            _send(client, reply, payload)
        except (EOFError, OSError):
            return False
        return reply.status != TORN

    def _reply(self, header: bytes) -> tuple[Reply, bytes | memoryview]:
        try:
            request = parse_request(header)
        except Torn as error:
            return Reply(TORN, 0), str(error).encode()
        try:
            return self._execute(request)
        except CameraError as error:
            return Reply(FAILED, request.id), str(error).encode()

    def _execute(self, request: Request) -> tuple[Reply, bytes | memoryview]:
        if request.verb == INFO:
            return Reply(OK, request.id), INFO_REPLY.pack(*self._source.size, *self._source.focus_range)
        if request.verb == SET_FOCUS:
            return Reply(OK, request.id), SET_FOCUS_REPLY.pack(self._source.set_focus(request.lens_position))
        if request.verb != READ:
            return Reply(UNKNOWN_VERB, request.id), f"unknown verb {request.verb}".encode()
        roi, (width, height) = request.roi, self._source.size
        if roi != FULL and not (0 < roi.width <= width - roi.x and 0 < roi.height <= height - roi.y):
            raise CameraError(f"region {tuple(roi)} (x, y, width, height) is not inside {width}x{height} pixels")
        frame = self._source.read(None if roi == FULL else roi, request.settle_us * 1e-6)
        pixels = np.ascontiguousarray(frame.image)  # a source may hand out a view of a larger frame
        return Reply(OK, request.id, frame.seq, frame.t_ns, frame.roi), pixels.data.cast("B")


def _listen(path: Path) -> socket.socket:
    """A listening socket in place of one that an earlier twin left behind; any other file stays."""
    try:
        if path.exists() and not stat.S_ISSOCK(path.stat().st_mode):
            raise CameraError(f"{path}: there is a file that is no socket; remove it or choose another directory")
        path.unlink(missing_ok=True)
        listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            listener.bind(str(path))
            path.chmod(0o600)  # before listen(): no other user connects in between
            listener.listen()
        except OSError:
            listener.close()
            raise
    except OSError as error:  # no such directory, or a path longer than the 107 bytes that a socket address holds
        raise CameraError(f"{path}: cannot serve a camera here: {error.strerror or error}; use a short path") from None
    return listener


def _send(connection: socket.socket, reply: Reply, payload: bytes | memoryview) -> None:
    connection.settimeout(STALL_S)
    connection.sendall(pack_reply(reply._replace(nbytes=len(payload))))
    connection.sendall(payload)


# --- client: the camera twin:ROBOT ---


def open_twin(path: Path, clock: Clock | None = None) -> TwinCamera:
    """Connect to the camera socket at `path`; frames are waited for by `clock`, the system's if not given.
    Raises CameraGone if no twin serves it, CameraError if it is in use."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(PATIENCE_S)
    try:
        connection.connect(str(path))
    except OSError as error:
        connection.close()
        reason = error.strerror or error
        raise CameraGone(f"{path}: no twin serves a camera here ({reason}); start it with: aucamp twin FLEET") from None
    camera = TwinCamera(connection, path, clock or SystemClock())
    try:
        camera.ask_info()
    except CameraError:
        camera.close()
        raise
    return camera


class TwinCamera:
    """One connection, closed after CameraGone: what was late must not be taken for the next answer."""

    def __init__(self, connection: socket.socket, path: Path, clock: Clock) -> None:
        self.size = (0, 0)
        self.stamp: Stamp = "exposure-start"
        self._focus_range = FocusRange(0, 0, 1)
        self._connection = connection
        self._path = path
        self._clock = clock
        self._ids = itertools.count(1)

    def ask_info(self) -> None:
        """Frame size and focus range, as a driver tells them."""
        request = Request(INFO, next(self._ids))
        width, height, lowest, highest, step = self._ask_numbers(request, INFO_REPLY)
        self.size, self._focus_range = (width, height), FocusRange(lowest, highest, step)

    def focus_range(self) -> FocusRange:
        return self._focus_range

    def set_focus(self, lens_position: int) -> int:
        request = Request(SET_FOCUS, next(self._ids), lens_position=nearest(lens_position, self._focus_range))
        return self._ask_numbers(request, SET_FOCUS_REPLY)[0]

    def read(self, roi: Roi | None = None, settle_s: float = 0.0, timeout_s: float = PATIENCE_S) -> Frame:
        part = FULL if roi is None else deliverable(roi, self.size)
        request = Request(READ, next(self._ids), settle_us=round(settle_s * 1e6), roi=part)
        reply, payload = self._ask(request, timeout_s)
        shape = (reply.roi.height, reply.roi.width, 3)
        if len(payload) != shape[0] * shape[1] * shape[2]:
            raise self._gone(f"sent {len(payload)} bytes for {shape[1]}x{shape[0]} pixels")
        return Frame(reply.t_ns, reply.seq, np.frombuffer(payload, np.uint8).reshape(shape), reply.roi)

    def close(self) -> None:
        self._connection.close()

    def _ask_numbers(self, request: Request, layout: struct.Struct) -> tuple[int, ...]:
        _, payload = self._ask(request, PATIENCE_S)  # the twin may have to finish a frame for a client that has left
        if len(payload) != layout.size:
            raise self._gone(f"sent {len(payload)} bytes instead of {layout.size}")
        return layout.unpack(payload)

    def _ask(self, request: Request, timeout_s: float) -> tuple[Reply, bytearray]:
        """One request, one reply. Raises CameraGone when the stream is of no more use."""
        until_ns = self._clock.now_ns() + round(timeout_s * 1e9)
        try:
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # the reply says why
                self._connection.settimeout(timeout_s)
                self._connection.sendall(pack_request(request))
            header = self._receive(REPLY_SIZE, until_ns)
            reply = parse_reply(bytes(header))
            payload = self._receive(reply.nbytes, until_ns)
        except TimeoutError:
            raise self._gone(f"no answer within {timeout_s} s") from None
        except (EOFError, OSError):
            raise self._gone("the twin hung up") from None
        except Torn as error:
            raise self._gone(f"no camera socket: {error}") from None
        if reply.status != OK:
            if reply.status in (BUSY, TORN):
                self.close()
            raise CameraError(f"{self._path}: {payload.decode(errors='replace')}")
        if reply.id != request.id:
            raise self._gone(f"answered request {reply.id} instead of {request.id}")
        return reply, payload

    def _receive(self, count: int, until_ns: int) -> bytearray:
        buffer = bytearray(count)
        receive_into(self._connection, memoryview(buffer), self._clock, until_ns)
        return buffer

    def _gone(self, why: str) -> CameraGone:
        self.close()
        return CameraGone(f"{self._path}: {why}")
