"""A camera whose driver lies: it stands between an agent and its camera in the twin, and passes on what both say."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np

from agent.process.command import temporary_folder
from hw.camera.camera import Roi
from hw.camera.frame_socket import (
    FULL,
    OK,
    READ,
    REPLY_SIZE,
    REQUEST_SIZE,
    Reply,
    pack_reply,
    parse_reply,
    parse_request,
)

Fault = Literal["empty", "again", "still", "silent"]


class BrokenCamera:
    """While `broken`, frames have 0 x 0 pixels ("empty"), are one frame again and again ("again") or new ones with one
    picture ("still"), or do not come at all ("silent")."""

    def __init__(self) -> None:
        self.broken: Fault | None = None
        self.spoiled = 0  # frames
        self._whole = 0, 0, np.empty((0, 0, 3), np.uint8)  # the newest whole frame: number, time, picture

    @contextlib.contextmanager
    def between(self, twin: Path) -> Iterator[Path]:
        """All that the twin has there, but in the place of r1's camera this one."""
        with temporary_folder() as elsewhere, socket.socket(socket.AF_UNIX) as listener:
            for path in twin.iterdir():
                if path.name != "r1.camera":
                    (elsewhere / path.name).symlink_to(path)
            listener.bind(str(elsewhere / "r1.camera"))
            listener.listen()
            threading.Thread(target=self._serve, args=(listener, twin / "r1.camera"), daemon=True).start()
            yield elsewhere
            listener.shutdown(socket.SHUT_RDWR)

    def _serve(self, listener: socket.socket, real: Path) -> None:
        """One client after the other, until the listener is closed."""
        with contextlib.suppress(OSError):
            while True:
                client, _ = listener.accept()
                with client, socket.socket(socket.AF_UNIX) as camera, contextlib.suppress(OSError, EOFError):
                    camera.connect(str(real))
                    while True:
                        self._answer(client, camera)

    def _answer(self, client: socket.socket, camera: socket.socket) -> None:
        asked = exactly(client, REQUEST_SIZE)
        camera.sendall(asked)
        header = exactly(camera, REPLY_SIZE)
        reply = parse_reply(header)
        payload = exactly(camera, reply.nbytes)
        if parse_request(asked).verb == READ and reply.status == OK:
            if self.broken is not None:
                self.spoiled += 1
                header, payload = self._spoilt(reply)
            elif parse_request(asked).roi == FULL:
                picture = np.frombuffer(payload, np.uint8).reshape(reply.roi.height, reply.roi.width, 3)
                self._whole = reply.seq, reply.t_ns, picture
        if self.broken != "silent":
            client.sendall(header + payload)

    def _spoilt(self, reply: Reply) -> tuple[bytes, bytes]:
        seq, t_ns, picture = self._whole
        if self.broken == "empty":
            return pack_reply(reply._replace(roi=Roi(0, 0, 0, 0), nbytes=0)), b""
        if self.broken == "again":
            reply = reply._replace(seq=seq, t_ns=t_ns)
        x, y, width, height = reply.roi
        return pack_reply(reply), picture[y : y + height, x : x + width].tobytes()


def exactly(connection: socket.socket, count: int) -> bytes:
    """So many bytes. Raises EOFError."""
    found = b""
    while len(found) < count:
        more = connection.recv(count - len(found))
        if not more:
            raise EOFError
        found += more
    return found
