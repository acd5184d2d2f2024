"""The socket of the calibration bench: JSON, one object a line.

{"board_m": [x, y, z] or null, "servo_us": [pan, tilt]} is answered by {"ok": true} or {"error": "..."}; for what they
mean see Bench.place.
"""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any

import msgspec

if TYPE_CHECKING:
    from hw.twin.bench import Bench

MAX_LINE = 1024  # bytes of a request
POLL_S = 0.2


class Request(msgspec.Struct, forbid_unknown_fields=True):
    board_m: tuple[float, float, float] | None
    servo_us: tuple[float, float]


def serve(bench: Bench, path: Path, stop: threading.Event, ready: Callable[[], None]) -> None:
    """Answer one client after the other until stopped; blocks. Calls ready() once a client can connect."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        path.chmod(0o600)
        listener.listen(1)
        listener.settimeout(POLL_S)
        ready()
        while not stop.is_set():
            try:
                connection, _ = listener.accept()
            except TimeoutError:
                continue
            with connection:
                _converse(bench, connection, stop)


def _converse(bench: Bench, connection: socket.socket, stop: threading.Event) -> None:
    connection.settimeout(POLL_S)
    pending = b""
    while not stop.is_set():
        try:
            chunk = connection.recv(MAX_LINE)
            if not chunk:
                return
            *lines, pending = (pending + chunk).split(b"\n")
            for line in lines:
                connection.sendall(json.dumps(_answer(bench, line)).encode() + b"\n")
        except TimeoutError:
            continue
        except OSError:
            return
        if len(pending) > MAX_LINE:
            return


def _answer(bench: Bench, line: bytes) -> dict[str, Any]:
    try:
        request = msgspec.json.decode(line, type=Request)
        bench.place(request.board_m, request.servo_us)
    except (msgspec.DecodeError, ValueError) as error:
        return {"error": str(error)}
    return {"ok": True}


class BenchClient:
    """The hand that moves the chessboard; `with BenchClient(folder / "r1.bench") as bench: bench.place(...)`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._connection: socket.socket | None = None

    def __enter__(self) -> BenchClient:
        self._connection = socket.socket(socket.AF_UNIX)
        self._connection.settimeout(10.0)
        try:
            self._connection.connect(str(self._path))
        except OSError:
            self._connection.close()
            raise ConnectionError(f"{self._path}: no bench here; start the twin with --bench") from None
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._connection is not None:
            self._connection.close()

    def place(self, board_m: tuple[float, float, float] | None, servo_us: tuple[float, float]) -> None:
        """Returns when everything is at rest. Raises ValueError if refused, ConnectionError if the bench is gone."""
        board = None if board_m is None else [float(v) for v in board_m]
        request = {"board_m": board, "servo_us": [float(v) for v in servo_us]}
        try:
            answer = json.loads(self._exchange(json.dumps(request).encode() + b"\n"))
        except (OSError, json.JSONDecodeError):
            raise ConnectionError(f"{self._path}: the bench has ended; start it again") from None
        if "error" in answer:
            raise ValueError(answer["error"])

    def _exchange(self, line: bytes) -> bytes:
        """Send a line; returns the line that answers it, short if the bench hangs up."""
        if self._connection is None:
            raise RuntimeError("use the client in a with statement")
        self._connection.sendall(line)
        reply = b""
        while not reply.endswith(b"\n"):
            chunk = self._connection.recv(MAX_LINE)
            if not chunk:
                break
            reply += chunk
        return reply
