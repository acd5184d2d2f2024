"""The camera socket's other end: a thread that serves one source of frames, a camera seen from inside the twin."""

from __future__ import annotations

import contextlib
import select
import socket
import stat
import threading
from pathlib import Path
from typing import Protocol

import numpy as np

from agent.clock.clock import SystemClock
from hw.camera.camera import CameraError, FocusRange, Frame, Roi
from hw.camera.frame_socket import (
    BUSY,
    FAILED,
    FULL,
    INFO,
    INFO_REPLY,
    OK,
    READ,
    REQUEST_SIZE,
    SET_FOCUS,
    SET_FOCUS_REPLY,
    TORN,
    UNKNOWN_VERB,
    Reply,
    Request,
    Torn,
    pack_reply,
    parse_request,
    receive_into,
)

STALL_S = 2.0  # a client that stops in the middle of a message for longer is dropped
POLL_S = 0.2  # how late the thread notices that it shall end


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
        client = self._client
        if client is not None:
            with contextlib.suppress(OSError):  # it may hang up by itself meanwhile
                client.shutdown(socket.SHUT_RDWR)
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _serve(self, listener: socket.socket) -> None:
        try:
            while not self._closing.is_set():
                watched = [listener] if self._client is None else [self._client, listener]
                for ready in select.select(watched, [], [], POLL_S)[0]:
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
        connection, _ = listener.accept()
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
            path.chmod(0o600)  # before listen(): nobody connects in between
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
