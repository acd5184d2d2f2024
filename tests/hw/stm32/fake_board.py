"""The other end of the tether without a board: frames as a board would send them, straight into the host's protocol."""

from __future__ import annotations

from hw.firmware import wire
from hw.stm32.protocol import HostProtocol


class FakeBoard:
    """Says what a board would, byte by byte."""

    def __init__(self, protocol: HostProtocol, boot_id: int = 5, version: int = wire.PROTOCOL) -> None:
        """version: the newest that it speaks."""
        self.protocol, self.boot_id, self.version, self.writer = protocol, boot_id, version, wire.Writer()

    def greet(self, schema: int | None = None, version: int | None = None, uid: bytes = b"") -> None:
        version = self.version if version is None else version
        schema = wire.schema_crc(version) if schema is None else schema
        can, count = (
            (0, 0, wire.CAN_VERSION_2, wire.CAN_VERSION_2 | wire.CAN_VERSION_3)[self.version],
            wire.PARAMETER_COUNTS[version],
        )
        self.say(wire.HELLO_ACK, version, schema, b"testtest", uid, self.boot_id, 1, 0, 0, count, can)

    def telemetry(
        self, armed: int = 0, flags: int = wire.FLAG_HELLO, rate: int = wire.NO_RATE, ladder: int = 0, now_ns: int = 1
    ) -> None:
        fields = 1, armed, ladder, flags, *[0] * 10, *[1500] * 12, 0, 15000, 0, 0, 0, 0, 0
        if self.version == 1:
            self.say_at(now_ns, wire.TELEM_1, *fields)
        else:
            self.say_at(now_ns, wire.TELEM, *fields, rate)

    def say(self, kind: int, *fields) -> None:
        self.say_at(1, kind, *fields)

    def say_at(self, now_ns: int, kind: int, *fields) -> None:
        self.protocol.receive(bytes(self.writer.frame(kind, *fields)), now_ns)


def kinds(out: bytes) -> list[int]:
    """Types of the frames in what the host sends."""
    return [kind for kind, _ in frames(out)]


def frames(out: bytes) -> list[tuple[int, tuple]]:
    """Types and fields of the frames in what the host sends."""
    got: list[tuple[int, tuple]] = []
    wire.Framer(lambda kind, _seq, payload: got.append((kind, wire.unpack(kind, payload)))).feed(out, len(out))
    return got
