"""Whatever reads bytes that come from outside, and what it may make of them: a value, or a refusal of its own kind."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from random import Random

import cv2
import msgpack
import numpy as np

from agent.core import messages, step_io, topics, trust
from agent.core.codec import Refusal, decode, encode
from agent.core.messages import Estimate, Image, LogLine, Message, Order, State
from agent.ground import schemas
from agent.robot.step import Agent
from hw.camera import frame_socket
from hw.camera.frame_socket import Reply, Request, Torn
from hw.camera.v4l2 import Format
from hw.camera.v4l2 import decode as picture
from hw.camera.v4l2_node import MJPG, NV12, YUYV
from hw.firmware import wire
from replay.files.channels import Entry
from replay.viewers.viewer_channels import ViewerChannels
from tests.fuzz import files, speakers
from tests.fuzz.decoder import MSGPACK, Decoder
from tests.fuzz.kernel.swarm import Scene, fleet_of
from tests.fuzz.values import integer, of_type
from tests.network.scripted_agent import CALIBRATION
from tests.sample_messages import telemetry

LIMITS = {Image: topics.IMAGE.limit, step_io.Inputs: 10**6, step_io.Outputs: 10**6}  # bytes, where not the usual one
WILDS = (0.0, 0.01, 0.05, 0.3)
WIDTH, HEIGHT = 8, 6  # of a picture


@cache
def decoders() -> tuple[Decoder, ...]:
    kinds = [kind for kind in (*vars(messages).values(), *vars(step_io).values(), Order) if _is_message(kind)]
    some = fleet_of(Scene())
    viewers = ViewerChannels(some)
    shown = ((topics.STATE, State), (topics.LOG, LogLine), (topics.IMAGE, Image), (topics.LINK, Estimate))
    return (
        *(
            Decoder(f"codec.{kind.__name__}", partial(_codec, kind), partial(_payload, kind), MSGPACK)
            for kind in sorted(set(kinds), key=str)
        ),
        Decoder("order", partial(_order, Agent(some, "r1", CALIBRATION, 1)), speakers.ordered, MSGPACK),
        Decoder("shown", _shown, partial(_payload, State), MSGPACK),
        Decoder("request", partial(_socket, frame_socket.parse_request), _request),
        Decoder("reply", partial(_socket, frame_socket.parse_reply), _reply),
        Decoder("frames", _frames, _tether),
        Decoder("jpeg", partial(_picture, MJPG), _jpeg),
        Decoder("yuyv", partial(_picture, YUYV), lambda rng: rng.randbytes(2 * WIDTH * HEIGHT)),
        Decoder("nv12", partial(_picture, NV12), lambda rng: rng.randbytes(3 * WIDTH * HEIGHT)),
        Decoder("key", _key, _address),
        Decoder("signature", _signature, lambda rng: rng.randbytes(200)),
        *(
            Decoder(f"viewer.{topic.name}", partial(_viewer, viewers, topic), partial(_payload, kind), MSGPACK)
            for topic, kind in shown
        ),
        *files.decoders(),
        *speakers.decoders(),
    )


# --- what they may do -------------------------------------------------------------------------------------------


def _codec(kind: type[Message], payload: bytes) -> None:
    try:
        message = decode(payload, kind, LIMITS.get(kind, messages.MAX_PAYLOAD))
    except Refusal as refusal:
        assert len(str(refusal)) <= 300, "a long refusal"
        return
    again = encode(message)
    assert encode(decode(again, kind, 2 * len(again) + 9)) == again, "other bytes the second time"


def _order(agent: Agent, payload: bytes) -> None:
    ordered = step_io.Ordered(arrived_ns=1, console="ann", payload=payload)
    agent.operator.take((ordered,), telemetry(10**9, depth_m=0.0), 10**9)
    before = step_io.Outputs(set_point=step_io.SetPoint(depth_m=0.4))
    (answer,) = agent.operator.complete(before, (ordered,), 10**9).answers
    assert len(encode(answer)) <= topics.ANSWER.limit, "an answer that nobody takes in"
    assert answer.ok is not bool(answer.why) and (answer.why + answer.order).isprintable(), "no line"
    for line in agent.status.log.fetch(10**9):
        assert line.text.isprintable(), "breaks the line"


def _shown(payload: bytes) -> None:
    line = schemas.decode("key", payload)
    assert line.isprintable(), "breaks the line"
    assert len(line) <= 40 * len(payload) + 40, "longer than what came"


def _socket(parse: Callable[[bytes], object], header: bytes) -> None:
    sizes = {frame_socket.parse_request: frame_socket.REQUEST_SIZE, frame_socket.parse_reply: frame_socket.REPLY_SIZE}
    header = header[: sizes[parse]].ljust(sizes[parse], b"\0")  # a reader takes so many bytes from the stream
    try:
        parse(header)
    except Torn:
        return


def _frames(stream: bytes) -> None:
    framer = wire.Framer(lambda kind, seq, payload: wire.unpack(kind, payload))
    for at in range(0, len(stream), 64):
        framer.feed(stream[at : at + 64], len(stream[at : at + 64]))
    assert framer.rx_ok + framer.rx_bad <= stream.count(0), "frames that nobody sent"


def _picture(fourcc: int, data: bytes) -> None:
    seen = picture(memoryview(data), Format((WIDTH, HEIGHT), fourcc, 2 * WIDTH, 1))
    assert seen is None or (seen.shape == (HEIGHT, WIDTH, 3) and seen.dtype == np.uint8), "no picture of this format"


def _key(text: bytes) -> None:
    topics.match(text.decode("utf-8", errors="replace"))


def _signature(data: bytes) -> None:
    assert not trust.verify_signature(data[:32], data[32:96], data[96:]), "forged"


def _viewer(viewers: ViewerChannels, topic: topics.Topic, payload: bytes) -> None:
    key = topics.key(topic, fleet="tank", robot="r1", src="r1", dst="r2")
    made = viewers(Entry(f"/zenoh/{key}", 1, 1, 1, payload, "msgpack", {}))
    assert len(list(made)) < 100, "many messages for one"


# --- what they were made for --------------------------------------------------------------------------------------


def _payload(kind: type[Message], rng: Random) -> bytes:
    try:
        return bytes(msgpack.packb(of_type(kind, rng, rng.choice(WILDS))))
    except (OverflowError, ValueError):
        return b""


def _request(rng: Random) -> bytes:
    numbers = [rng.randrange(2**16) for _ in range(4)]
    roi = frame_socket.Roi(*numbers)
    return frame_socket.pack_request(Request(rng.randrange(5), rng.randrange(2**32), 7, rng.randrange(2**31), roi))


def _reply(rng: Random) -> bytes:
    roi = frame_socket.Roi(*(rng.randrange(2**16) for _ in range(4)))
    size = rng.choice((0, 1, 64 << 20, (64 << 20) + 1, 2**32 - 1))
    return frame_socket.pack_reply(Reply(rng.randrange(6), rng.randrange(2**32), 1, rng.randrange(2**64), roi, size))


def _tether(rng: Random) -> bytes:
    writer = wire.Writer()
    return b"".join(
        bytes(writer.log(rng.randrange(256), rng.randbytes(rng.randrange(60))))
        if rng.random() < 0.5
        else bytes(writer.frame(wire.HELLO, rng.randrange(2**16), rng.randrange(2**32), rng.randrange(2**32)))
        for _ in range(rng.randrange(1, 6))
    )


def _jpeg(rng: Random) -> bytes:
    noise = np.frombuffer(rng.randbytes(HEIGHT * WIDTH * 3), np.uint8).reshape(HEIGHT, WIDTH, 3)
    return cv2.imencode(".jpg", noise)[1].tobytes() + bytes(rng.randrange(3))  # some drivers pad


def _address(rng: Random) -> bytes:
    parts = [
        rng.choice(("aucamp", "tank", "link", "robot", "r1", "state", "*", "**", "", str(integer(rng))))
        for _ in range(rng.randrange(1, 9))
    ]
    return "/".join(parts).encode()


def _is_message(kind: object) -> bool:
    return isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
