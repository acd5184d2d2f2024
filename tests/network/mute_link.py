"""A link that Zenoh leaves mute: two peers, a proxy that delays the handshake, a process stopped in the middle of it.

r2 dials r1 through the proxy. It holds r1's first answer for most of two seconds and stops r2 when the second is on its
way, until two seconds have gone since it dialled: time-outs of two seconds come, and so does the answer.
`python -m tests.network.mute_link NAME OTHER` is a peer: its configuration comes on standard input, and a line goes out
for each message that it hears. With WATCHED=no nothing heals its links.
"""

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self

from agent.core import topics
from agent.core.config import Fleet
from agent.core.topics import LINK
from router_config import session
from router_config.settings import peer_config
from tests.killing import killed_after
from tests.places import ROOT
from tests.waiting import until

HELD_S, STOPPED_UNTIL_S = 1.9, 2.2  # since r2 dialled
SAY_S = 0.05
FLEET = "test"
SHORT = {"open_timeout": 2000, "accept_timeout": 2000}  # with which a link gets mute


class Frames(NamedTuple):
    """How one protocol frames what it says, and which frame of r1's is its first answer."""

    header: int
    first: int

    def length(self, header: bytes) -> int:
        return int.from_bytes(header, "little") if self.header == 2 else int.from_bytes(header[3:], "big")


FRAMES = {"tcp": Frames(2, 1), "tls": Frames(5, 5)}  # after four of its handshake


class Proxy:
    """Passes on all that is said; handshakes late, until one was. Context manager. `dials`: when each was taken."""

    def __init__(self, listen: socket.socket, r1: tuple[str, int], frames: Frames) -> None:
        self._listen, self._r1, self._frames = listen, r1, frames
        self.dials: list[float] = []
        self.r2_pid = 0
        self.went_on_s = 0.0  # when r2 was let go on
        self._sockets: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept)]

    def __enter__(self) -> Self:
        self._threads[0].start()
        return self

    def __exit__(self, *_: object) -> None:
        for one in (self._listen, *self._sockets):
            with contextlib.suppress(OSError):
                one.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()
        for one in self._sockets:
            one.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                r2, _ = self._listen.accept()
                self._sockets.append(r2)
                self.dials.append(time.monotonic())
                r1 = socket.create_connection(self._r1)
                self._sockets.append(r1)
                for one in (r1, r2):
                    one.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                for ends in ((r1, r2, not self.went_on_s), (r2, r1, False)):  # again, where one was given up too early
                    self._threads.append(threading.Thread(target=self._pass, args=ends))
                    self._threads[-1].start()

    def _pass(self, src: socket.socket, dst: socket.socket, delays: bool) -> None:
        number, dialled_s = 0, self.dials[-1]
        try:
            while True:
                header = self._whole(src, self._frames.header)
                frame = header + self._whole(src, self._frames.length(header))
                number += 1
                if delays and number == self._frames.first:
                    time.sleep(HELD_S)
                if delays and number == self._frames.first + 1:
                    os.kill(self.r2_pid, signal.SIGSTOP)
                    try:
                        dst.sendall(frame)
                        time.sleep(max(0.0, dialled_s + STOPPED_UNTIL_S - time.monotonic()))
                    finally:
                        os.kill(self.r2_pid, signal.SIGCONT)
                    self.went_on_s = time.monotonic()
                else:
                    dst.sendall(frame)
        except OSError:
            for one in (src, dst):
                with contextlib.suppress(OSError):
                    one.shutdown(socket.SHUT_RDWR)

    def _whole(self, src: socket.socket, length: int) -> bytes:
        found = b""
        while len(found) < length:
            part = src.recv(length - len(found))
            if not part:
                raise ConnectionError
            found += part
        return found


class Pair:
    """Two peers and what is between them; `first_s`: when each heard something first, once r2 was let go on."""

    def __init__(self, proxy: Proxy) -> None:
        self.proxy = proxy
        self.first_s: dict[str, float] = {}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}

    def listen(self, name: str) -> None:
        """In a thread of its own."""
        stdout = self.processes[name].stdout
        assert stdout is not None
        with stdout:
            for _ in stdout:
                if self.proxy.went_on_s:
                    self.first_s.setdefault(name, time.monotonic())

    def healed_s(self, timeout_s: float) -> float | None:
        """From r2's going on until both hear; None: they do not within `timeout_s`."""
        with contextlib.suppress(AssertionError):
            until(lambda: len(self.first_s) == 2, timeout_s)
            return max(self.first_s.values()) - self.proxy.went_on_s
        return None


@contextlib.contextmanager
def provoked(fleet: Fleet, keys: Path | None = None, short: bool = False, watched: bool = True) -> Iterator[Pair]:
    """r1 and r2 of the fleet, after the handshake that a stop went through. `short`: Zenoh's own time-outs come."""
    protocol, _, where = fleet.robot["r1"].listen.partition("/")
    host, port = where.rpartition(":")[0].strip("[]"), int(where.rpartition(":")[2])
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with (
        socket.create_server((host, 0), family=family) as door,
        Proxy(door, (host, port), FRAMES[protocol]) as proxy,
        contextlib.ExitStack() as after,
    ):
        pair = Pair(proxy)
        readers = {name: threading.Thread(target=pair.listen, args=(name,)) for name in ("r1", "r2")}
        for name, other in (("r1", "r2"), ("r2", "r1")):
            config = json.loads(peer_config(fleet, name, keys))
            if name == "r2":
                config["connect"]["endpoints"] = [f"{protocol}/{where.rpartition(':')[0]}:{door.getsockname()[1]}"]
            if short:
                config["transport"]["unicast"] |= SHORT
            process = pair.processes[name] = subprocess.Popen(
                [sys.executable, "-m", "tests.network.mute_link", name, other],
                cwd=ROOT,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "WATCHED": "yes" if watched else "no"},
            )
            after.callback(readers[name].join)
            after.enter_context(killed_after({name: process}))
            assert process.stdin is not None and process.stdout is not None
            proxy.r2_pid = process.pid
            process.stdin.write(json.dumps(config).encode())
            process.stdin.close()
            if name == "r1":
                process.stdout.readline()  # it listens
            readers[name].start()
        until(lambda: proxy.went_on_s)
        yield pair


def peer(name: str, other: str, config: str) -> None:
    """Until it is killed."""
    if os.environ.get("WATCHED") == "no":
        session.LinkWatchdog._look = lambda self: None  # type: ignore[method-assign]

    def heard(_: session.Sample) -> None:
        os.write(1, b"heard\n")

    with session.Session(config, name) as it:
        it.subscribe(topics.key(LINK, fleet=FLEET, src=other, dst=name), heard)
        publish = it.publisher(LINK, topics.key(LINK, fleet=FLEET, src=name, dst=other))
        os.write(1, b"open\n")
        while True:
            publish(b"something")
            time.sleep(SAY_S)


if __name__ == "__main__":
    peer(sys.argv[1], sys.argv[2], sys.stdin.read())
