"""A camera whose driver lies: it stands between an agent and its camera in the twin, and passes on what both say."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

from agent.process.command import temporary_folder
from hw.camera.camera import Roi
from hw.camera.frame_socket import OK, READ, REPLY_SIZE, REQUEST_SIZE, pack_reply, parse_reply, parse_request


class BrokenCamera:
    """While `broken`, frames have 0 x 0 pixels."""

    def __init__(self) -> None:
        self.broken = False
        self.spoiled = 0  # frames

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
        if self.broken and parse_request(asked).verb == READ and reply.status == OK:
            self.spoiled += 1
            header, payload = pack_reply(reply._replace(roi=Roi(0, 0, 0, 0), nbytes=0)), b""
        client.sendall(header + payload)


def exactly(connection: socket.socket, count: int) -> bytes:
    """So many bytes. Raises EOFError."""
    found = b""
    while len(found) < count:
        more = connection.recv(count - len(found))
        if not more:
            raise EOFError
        found += more
    return found
