"""A fleet of two, what its robots say, and a page's end of the socket without a browser."""

import asyncio
import contextlib
import json
import struct
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from cv2 import imencode
from websockets.sync.client import ClientConnection, connect

from agent.core.capability_messages import TURN_ONE, Frame, Keyframe, Lens
from agent.core.codec import encode
from agent.core.config import Fleet, Pose, Robot, Target, dump
from agent.core.messages import Image, LogLine, Message, State
from agent.core.topics import Topic, key, match
from agent.ground.page.rows import Board
from agent.ground.page.server import serving
from replay.files.channels import NETWORK, Entry, name
from replay.files.log import LogWriter
from tests.network.conftest import unused_port

TOKEN = "a-token-of-this-run"
NOW_NS = 1_795_632_591_025_909_192  # more digits than a number of JavaScript has
FLEET = Fleet(
    fleet="test",
    target={"ball": Target(radius_m=0.07), "stone": Target(detector="box", picture="s.jpg", box=(0, 0, 9, 9))},
    robot={
        name: Robot(
            neighbours=("r2" if name == "r1" else "r1",),
            listen=f"tcp/127.0.0.1:{port}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=x_m, y_m=0.3, yaw_deg=90.0),
            calibration=f"{name}.toml",
        )
        for name, port, x_m in (("r1", 17401, 0.4), ("r2", 17402, 1.1))
    },
)


def state(robot: str = "r1", target: str = "ball", **about: Any) -> State:
    head = {"fleet": "test", "incarnation": NOW_NS - 5, "seq": 3, "sent_ns": NOW_NS, "t": 7}
    place = {"posterior_m": (0.76, 0.56, 0.07), "posterior_sigma_m": 0.0015, "armed": True, "depth_m": 0.4}
    return State(robot=robot, target=target, **{**head, "knows": "sees", **place, **about})


def keyframe(src: str, **changes: Any) -> Keyframe:
    """r1 has looked straight down from 0.4 m, at four blocks; the last one has no depth."""
    lens = Lens(f=5000, cx=320, cy=320, bend=0, ahead=0, block=32, cols=2)
    depths = b"".join(z.to_bytes(2, "little") for z in (2500, 2500, 5000, 0))
    about = {"origin": "r1", "incarnation": 7, "number": 3, "place": (5000, 6000, 4000), "turn": (0, TURN_ONE, 0, 0)}
    frame = Frame(**{**about, "lens": lens, "depths": depths, "sigmas": bytes(4), **changes})
    return Keyframe(fleet="test", src=src, dst="r2", incarnation=7, seq=1, sent_ns=NOW_NS, frame=frame)


def log(robot: str = "r1", text: str = "sees since iteration 6", **about: Any) -> LogLine:
    return LogLine(robot=robot, level="info", text=text, **{"sent_ns": NOW_NS, **about})


def jpeg(width_px: int = 64, height_px: int = 48, grey: int = 90) -> bytes:
    return bytes(imencode(".jpg", np.full((height_px, width_px, 3), grey, np.uint8))[1])


def image(robot: str = "r1", frame: int = 12, **about: Any) -> Image:
    size = {"width_px": 64, "height_px": 48, "enhanced": False, "jpeg": jpeg()}
    return Image(robot=robot, frame=frame, **{"seq": 0, "sent_ns": NOW_NS, "t_ns": NOW_NS, **size, **about})


def row(message: Message, topic: Topic, **chunks: str) -> tuple[Topic, dict[str, str], bytes]:
    """A row as it comes from the network."""
    found = match(key(topic, fleet="test", **chunks))
    assert found is not None
    return *found, encode(message)


def record(path: Path, said: list[tuple[int, tuple[Topic, dict[str, str], bytes]]]) -> None:
    """A recording of the fleet: (ns, row)."""
    run = {"kind": "fleet", "fleet": "test", "schema": "2"}
    with LogWriter(path, run, {"fleet.toml": dump(FLEET)}) as out:
        for at_ns, (topic, chunks, payload) in said:
            channel, about = name(NETWORK, key=key(topic, **chunks)), {"schema": f"aucamp.{topic.message.__name__}"}
            out.put(Entry(channel, at_ns, at_ns, 0, payload, "msgpack", about, None, False))


@contextlib.contextmanager
def served(board: Board, heard: Callable[[dict], None] = lambda message: None) -> Iterator[tuple[int, Any]]:
    """The board behind its server, in a thread: its port, and a function that calls another one in its loop."""
    port, ready, loop = unused_port(), threading.Event(), asyncio.new_event_loop()
    ended = asyncio.Event()

    async def hears(message: dict) -> None:
        heard(message)

    async def serve() -> None:
        async with serving(board, hears, port, TOKEN):
            ready.set()
            await ended.wait()

    thread = threading.Thread(target=lambda: loop.run_until_complete(serve()))
    thread.start()
    try:
        assert ready.wait(60)

        def call(function: Callable[[], Any]) -> Any:
            async def wrapped() -> Any:
                return function()

            return asyncio.run_coroutine_threadsafe(wrapped(), loop).result(20)

        yield port, call
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(20)
        loop.close()


def opened(port: int, token: str = TOKEN, **about: Any) -> ClientConnection:
    """A page's socket, as a browser would open it from our page."""
    said = {"origin": f"http://127.0.0.1:{port}", "compression": None, "open_timeout": 20, **about}
    return connect(f"ws://127.0.0.1:{port}/ws?token={token}", **said)


def received(data: str | bytes) -> list[dict[str, Any]]:
    """The messages of one frame of the socket, a picture too."""
    if isinstance(data, str):
        return json.loads(data)
    robot, frame, t_ns = struct.unpack("<BIQ", data[:13])
    robots = list(FLEET.robot)
    return [{"k": f"image/{robots[robot]}", "frame": frame, "t_ns": t_ns, "jpeg": data[13:]}]
