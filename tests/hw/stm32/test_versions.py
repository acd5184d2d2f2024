"""Boards and hosts of two versions of the protocol: the older one is served as it always was."""

import math
import sys

import pytest
from msgspec import UNSET

from hw.firmware import wire
from hw.stm32.protocol import HostProtocol
from tests.hw.stm32.fake_board import FakeBoard, frames

MS = 1_000_000
HOST_BOOT = 9


def greetings(out):
    return [fields for kind, fields in frames(out) if kind == wire.HELLO]


def test_an_old_board_hears_what_it_always_heard() -> None:
    protocol = HostProtocol(HOST_BOOT)
    board = FakeBoard(protocol, version=1)
    assert greetings(protocol.due(0)) == [(1, 0xA725AA30, HOST_BOOT)]
    board.greet()
    assert not any(protocol.due(ms * MS) for ms in range(10, 3000, 10)), "nothing more to be said"
    board.telemetry()
    assert protocol.telemetry[-1].rate_rad_s is UNSET
    assert [line.text for line in protocol.lines] == ["board testtest, boot 00000005"]


def test_a_new_board_is_greeted_in_what_it_offers_until_it_agrees() -> None:
    protocol = HostProtocol(HOST_BOOT)
    board = FakeBoard(protocol)
    protocol.due(0)
    board.greet(version=1)
    asked = [ms for ms in range(10, 1200, 10) if greetings(protocol.due(ms * MS)) == [(2, wire.SCHEMA_CRC[2], 9)]]
    assert asked == [10, 510, 1010]
    protocol.arm()
    board.greet()
    assert wire.ARM in [kind for kind, _ in frames(protocol.due(1200 * MS))]
    assert not greetings(protocol.due(3000 * MS))
    board.telemetry(rate=-4500)
    assert protocol.telemetry[-1].rate_rad_s == pytest.approx(math.radians(-45.0))
    board.telemetry()
    assert protocol.telemetry[-1].rate_rad_s is UNSET
    assert [line.text for line in protocol.lines] == ["board testtest, boot 00000005"], "one greeting for people"


def test_a_board_that_restarts_as_an_older_one_is_served_as_that() -> None:
    protocol = HostProtocol(HOST_BOOT)
    FakeBoard(protocol).greet()
    old = FakeBoard(protocol, boot_id=6, version=1)
    old.telemetry(flags=0)
    assert greetings(protocol.due(1000 * MS)) == [(1, wire.SCHEMA_CRC[1], HOST_BOOT)]
    old.greet()
    assert not protocol.due(3000 * MS)


@pytest.mark.parametrize(("version", "kind"), [(1, wire.TELEM_1), (2, wire.TELEM)])
def test_the_firmware_speaks_both(put_on_desk, version, kind) -> None:
    desk = put_on_desk(sys.executable)
    desk.yaw_rate = 4321
    desk.say(wire.HELLO, version, wire.SCHEMA_CRC[version], 77)
    said = desk.until(lambda: desk.heard(wire.HELLO_ACK))[0]
    assert said[:2] == (version, wire.SCHEMA_CRC[version]) and said[-1] & wire.CAN_VERSION_2
    desk.forget()
    desk.tick(6)
    told = desk.heard(kind)
    assert len(told) >= 2 and len(told) == len(desk.heard(wire.TELEM) + desk.heard(wire.TELEM_1))
    assert told[-1][3] & wire.FLAG_HELLO
    assert told[-1][-1] == 4321 if version == 2 else len(told[-1]) == 33


def test_the_firmware_refuses_what_it_does_not_know(put_on_desk) -> None:
    desk = put_on_desk(sys.executable)
    desk.say(wire.HELLO, 3, 12345, 77)
    assert desk.until(lambda: desk.heard(wire.HELLO_ACK))[0][:2] == (wire.PROTOCOL, wire.schema_crc())
    desk.forget()
    desk.tick(6)
    assert not any(fields[3] & wire.FLAG_HELLO for fields in desk.heard(wire.TELEM_1))
