"""The other end of the tether without a board: frames as a board would send them, straight into the host's protocol."""

from __future__ import annotations

from hw.firmware import parameters, wire
from hw.stm32.protocol import HostProtocol


class FakeBoard:
    """Says what a board would, byte by byte."""

    def __init__(self, protocol: HostProtocol, boot_id: int = 5) -> None:
        self.protocol, self.boot_id, self.writer = protocol, boot_id, wire.Writer()

    def greet(self, schema: int | None = None) -> None:
        schema = wire.schema_crc() if schema is None else schema
        count = len(parameters.TABLE)
        self.say(wire.HELLO_ACK, wire.PROTOCOL, schema, b"testtest", b"", self.boot_id, 1, 0, 0, count, 0)

    def telemetry(self, armed: int = 0, flags: int = wire.FLAG_HELLO) -> None:
        self.say(wire.TELEM, 1, armed, 0, flags, *[0] * 10, *[1500] * 12, 0, 15000, 0, 0, 0, 0, 0)

    def say(self, kind: int, *fields) -> None:
        self.say_at(1, kind, *fields)

    def say_at(self, now_ns: int, kind: int, *fields) -> None:
        self.protocol.receive(bytes(self.writer.frame(kind, *fields)), now_ns)


def kinds(out: bytes) -> list[int]:
    """Types of the frames in what the host sends."""
    got: list[int] = []
    wire.Framer(lambda kind, _seq, _payload: got.append(kind)).feed(out, len(out))
    return got
