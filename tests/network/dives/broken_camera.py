"""A camera whose driver lies: it stands between an agent and its camera in the twin, and passes on what both say."""

import contextlib
import socket
import threading
from collections.abc import Iterator
from pathlib import Path

from hw.camera.camera import Roi
from hw.camera.frame_socket import OK, READ, REPLY_SIZE, REQUEST_SIZE, Reply, pack_reply, parse_reply, parse_request


class BrokenCamera:
    """While `broken`, every frame has 0 x 0 pixels."""

    def __init__(self, real: Path) -> None:
        self.broken = False
        self.spoiled = 0  # frames
        self._real = real

    def serve(self, listener: socket.socket) -> None:
        """One client after the other, until the listener is closed."""
        with contextlib.suppress(OSError):
            while True:
                client, _ = listener.accept()
                with client, socket.socket(socket.AF_UNIX) as camera, contextlib.suppress(OSError, EOFError):
                    camera.connect(str(self._real))
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
            header, payload = pack_reply(Reply(OK, reply.id, reply.seq, reply.t_ns, Roi(0, 0, 0, 0), 0)), b""
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


@contextlib.contextmanager
def broken_camera(real: Path, at: Path) -> Iterator[BrokenCamera]:
    """Serve the camera at the socket `real` at another one."""
    camera = BrokenCamera(real)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(at))
        listener.listen()
        thread = threading.Thread(target=camera.serve, args=(listener,), daemon=True)
        thread.start()
        yield camera
        listener.shutdown(socket.SHUT_RDWR)
