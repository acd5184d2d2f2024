"""twin: a camera of the tank twin, seen through its socket (hw.camera.frame_socket)."""

from __future__ import annotations

import contextlib
import itertools
import socket
import struct
from pathlib import Path

import numpy as np

from agent.clock.clock import Clock, SystemClock
from hw.camera import frame_socket
from hw.camera.camera import PATIENCE_S, CameraError, CameraGone, FocusRange, Frame, Roi, deliverable, nearest
from hw.camera.frame_socket import FULL, INFO, OK, READ, SET_FOCUS, Reply, Request


def open_twin(path: Path, clock: Clock | None = None) -> TwinCamera:
    """Connect to the camera socket at `path`; frames are waited for by `clock`, the system's if not given.
    Raises CameraGone if nobody serves it, CameraError if it is in use."""
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
        self._focus_range = FocusRange(0, 0, 1)
        self._connection = connection
        self._path = path
        self._clock = clock
        self._ids = itertools.count(1)

    def ask_info(self) -> None:
        """Frame size and focus range, as a driver tells them."""
        request = Request(INFO, next(self._ids))
        width, height, lowest, highest, step = self._ask_numbers(request, frame_socket.INFO_REPLY)
        self.size, self._focus_range = (width, height), FocusRange(lowest, highest, step)

    def focus_range(self) -> FocusRange:
        return self._focus_range

    def set_focus(self, lens_position: int) -> int:
        request = Request(SET_FOCUS, next(self._ids), lens_position=nearest(lens_position, self._focus_range))
        return self._ask_numbers(request, frame_socket.SET_FOCUS_REPLY)[0]

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
            with contextlib.suppress(BrokenPipeError, ConnectionResetError):  # why we were refused is still to be read
                self._connection.settimeout(timeout_s)
                self._connection.sendall(frame_socket.pack_request(request))
            header = self._receive(frame_socket.REPLY_SIZE, until_ns)
            reply = frame_socket.parse_reply(bytes(header))
            payload = self._receive(reply.nbytes, until_ns)
        except TimeoutError:
            raise self._gone(f"no answer within {timeout_s} s") from None
        except (EOFError, OSError):
            raise self._gone("the twin hung up") from None
        except frame_socket.Torn as error:
            raise self._gone(f"no camera socket: {error}") from None
        if reply.status != OK:
            if reply.status in (frame_socket.BUSY, frame_socket.TORN):
                self.close()
            raise CameraError(f"{self._path}: {payload.decode(errors='replace')}")
        if reply.id != request.id:
            raise self._gone(f"answered request {reply.id} instead of {request.id}")
        return reply, payload

    def _receive(self, count: int, until_ns: int) -> bytearray:
        buffer = bytearray(count)
        frame_socket.receive_into(self._connection, memoryview(buffer), self._clock, until_ns)
        return buffer

    def _gone(self, why: str) -> CameraGone:
        self.close()
        return CameraGone(f"{self._path}: {why}")
