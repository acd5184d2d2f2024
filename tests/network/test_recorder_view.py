"""The live view: what robots show arrives at a Foxglove client, and nothing listens but on this machine.

On the wall: nobody dives.
"""

import base64
import contextlib
import itertools
import json
import os
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from msgspec.structs import replace

import replay.recorder
from agent.clock.clock import SystemClock
from agent.core.config import ConfigError, Fleet, dump
from agent.core.messages import MAX_JPEG, Image, State
from agent.ground.observe import view_fleets
from agent.process.launch import is_free
from agent.process.transport import Transport
from replay.recorder import view
from tests.network.conftest import unused_port
from tests.waiting import until

foxglove = pytest.importorskip("foxglove", reason="the extra `view` is not installed")


class Client:
    """A WebSocket client (RFC 6455), as much of it as a viewer that only listens needs."""

    def __init__(self, port: int) -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=60)
        key = base64.b64encode(os.urandom(16)).decode()
        self._socket.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Key: {key}\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        self._file = self._socket.makefile("rb")
        assert b"101" in self._file.readline()
        while self._file.readline().strip():
            pass

    def messages(self) -> Iterator[tuple[int, bytes]]:
        """(opcode, payload): 1 is JSON, 2 is data."""
        while True:
            first, length = self._file.read(2)
            if length == 126:
                (length,) = struct.unpack(">H", self._file.read(2))
            elif length == 127:
                (length,) = struct.unpack(">Q", self._file.read(8))
            yield first & 0x0F, self._file.read(length)

    def send(self, message: dict[str, object]) -> None:
        data = json.dumps(message).encode()
        head = bytes([0x81, 0x80 | len(data)]) if len(data) < 126 else struct.pack(">BBH", 0x81, 0x80 | 126, len(data))
        self._socket.sendall(head + bytes(4) + data)  # the mask may be zero

    def close(self) -> None:
        self._file.close()
        self._socket.close()


def test_a_viewer_sees_what_a_robot_shows(
    make_fleet: Callable[..., Fleet], state: Callable[..., State], free_port: int
) -> None:
    fleet, stop, lines = make_fleet({"r1": ()}), threading.Event(), []

    def shows(robot: Transport) -> None:
        for seq in itertools.count():
            robot.show(replace(state("r1", seq), prior_m=(0.7, 0.5, 0.1), posterior_m=(0.7, 0.5, 0.1)))
            robot.show(preview(seq))
            if stop.wait(0.05):
                return

    with ThreadPoolExecutor(2) as pool, Transport(fleet, "r1", time.time_ns) as r1:
        serving, showing = (
            pool.submit(view, fleet, stop, SystemClock(), free_port, lines.append),
            pool.submit(shows, r1),
        )
        try:
            until(lambda: lines or serving.done())
            with contextlib.closing(Client(free_port)) as client:
                of_robot = {"/r1/plot/protocol", "/r1/target/prior", "/r1/target/estimate", "/r1/preview"}
                expected = {*of_robot, "/plot/clock"}
                assert subscribed(client, len(expected)) == expected
        finally:
            stop.set()
            serving.result(timeout=60)
            showing.result(timeout=60)
    assert f"ws://127.0.0.1:{free_port}" in lines[0]


def preview(seq: int) -> Image:
    jpeg, now_ns = bytes(MAX_JPEG), time.time_ns()  # the largest; nobody decodes it on the way
    about = {"width_px": 640, "height_px": 480, "enhanced": False, "jpeg": jpeg}
    return Image(robot="r1", seq=seq, sent_ns=now_ns, t_ns=now_ns, frame=seq, **about)


def subscribed(client: Client, count: int) -> set[str]:
    """Subscribe to every channel that is offered; the topics of the messages, once they are of so many channels."""
    topics: dict[int, str] = {}
    seen: set[str] = set()
    for kind, data in client.messages():
        if kind == 1:
            told = json.loads(data)
            new = {channel["id"]: channel["topic"] for channel in told.get("channels", ())}
            assert all(channel["encoding"] == "protobuf" for channel in told.get("channels", ()))
            if told["op"] == "status":  # a client faster than the server, which offers a channel before it knows it
                time.sleep(0.1)
                new = {id_: topic for id_, topic in topics.items() if topic not in seen}
            topics |= new
            if new:
                client.send({"op": "subscribe", "subscriptions": [{"id": id_, "channelId": id_} for id_ in new]})
        elif kind == 2 and data[0] == 1:  # message data: subscription, time, payload
            seen.add(topics[struct.unpack("<I", data[1:5])[0]])
            if len(seen) == count:
                return seen
    raise AssertionError("the server hung up")


def test_each_of_several_fleets_has_a_port_of_its_own(
    make_fleet: Callable[..., Fleet], state: Callable[..., State], tmp_path: Path
) -> None:
    fleets = {
        name: replace(make_fleet({robot: ()}), fleet=name) for name, robot in {"east": "r1", "west": "w1"}.items()
    }
    for name, fleet in fleets.items():
        (tmp_path / f"{name}.toml").write_text(dump(fleet))
    first = next(port for port in iter(unused_port, None) if all(is_free(f"tcp/127.0.0.1:{port + k}") for k in (0, 1)))
    paths, lines, stop = [tmp_path / f"{name}.toml" for name in fleets], [], threading.Event()
    with contextlib.ExitStack() as stack, ThreadPoolExecutor(1) as pool:
        serving = pool.submit(view_fleets, paths, first, stop, lines.append)
        stack.callback(stop.set)
        robots = [
            (name, stack.enter_context(Transport(fleet, robot, time.time_ns)), robot)
            for name, fleet in fleets.items()
            for robot in fleet.robot
        ]
        until(lambda: sum("ws://" in line for line in lines) == 2 or serving.done())
        for port, (name, transport, robot) in enumerate(robots, start=first):
            assert any(line.startswith(f"fleet '{name}'") and f"ws://127.0.0.1:{port}" in line for line in lines)
            with contextlib.closing(Client(port)) as client:
                ours = showing_again(transport, replace(state(robot), fleet=name), stack)
                assert subscribed(client, 2) == {f"/{robot}/plot/protocol", "/plot/clock"}
                ours.set()
        stop.set()
        serving.result(timeout=60)


def showing_again(transport: Transport, shown: State, stack: contextlib.ExitStack) -> threading.Event:
    """Show this again and again until the event is set, or the stack is left."""
    stop = threading.Event()

    def show() -> None:
        while not stop.wait(0.05):
            transport.show(shown)

    thread = threading.Thread(target=show)
    thread.start()
    stack.callback(thread.join)
    stack.callback(stop.set)
    return stop


def test_a_port_that_is_taken_is_one_line(make_fleet: Callable[..., Fleet]) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(ConfigError, match="choose another with --port"):
            view(make_fleet({"r1": ()}), threading.Event(), SystemClock(), other.getsockname()[1])
    assert replay.recorder.HOST == "127.0.0.1"
