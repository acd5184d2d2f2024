"""Any bytes from the ground station's port: nothing breaks, and nobody is armed who was not addressed."""

import random
from collections.abc import Iterator

import pytest

pytest.importorskip("pymavlink", reason="pip install 'aucamp[mavlink]'")
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.core.config import Fleet
from tests.ground.bridges.states import START_NS, state
from tests.ground.bridges.station import ARM, MODE, REQUEST, Station, answer


def datagrams(chance: random.Random, count: int) -> Iterator[bytes]:
    """Noise; messages of every kind with any bytes as their fields, and a checksum that is right."""
    kinds = list(mavlink.mavlink_map.values())
    writer = mavlink.MAVLink(None, 255, 190)
    for _ in range(count):
        if chance.random() < 0.2:
            yield chance.randbytes(chance.randrange(300))
            continue
        kind = chance.choice([*kinds, *(mavlink.MAVLink_command_long_message,) * 100])
        head = bytes([kind.id & 255, kind.id >> 8 & 255, kind.id >> 16])
        payload = chance.randbytes(kind.unpacker.size)
        if kind is mavlink.MAVLink_command_long_message and chance.random() < 0.5:
            numbers = chance.choices([0.0, 1.0, 2.0, 9.0, float("nan"), float("inf"), -1e30, 148.0], k=7)
            command = chance.choice([ARM, MODE, REQUEST, mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES])
            payload = kind.unpacker.pack(*numbers, command, chance.choice([0, 1, 2, 9]), 1, 0)
        body = bytes([len(payload), 0, 0, writer.seq, 255, 190]) + head + payload
        sum_ = mavlink.x25crc(body)
        sum_.accumulate(bytes([kind.crc_extra]))
        yield b"\xfd" + body + sum_.crc.to_bytes(2, "little")


def test_whatever_arrives_breaks_nothing_and_arms_nobody_by_system_0(fleet: Fleet) -> None:
    station = Station(fleet)
    for robot in fleet.robot:
        station.gateway.shown(state(robot), START_NS, START_NS)
    reader = mavlink.MAVLink(None)
    reader.robust_parsing = True
    understood: set[str] = set()
    for data in datagrams(random.Random(20), 20_000):
        for message in reader.parse_buffer(data) or ():
            understood.add(message.get_type())
            before = len(station.given)
            station.gateway.heard(message, START_NS, START_NS)
            if getattr(message, "target_system", None) == 0:
                assert {verb for _, verb, _ in station.given[before:]} <= {"disarm", "surface"}
            for robot, _, done in station.given[before:]:
                done(answer(robot))
            station.gateway.tick(START_NS, START_NS)
    assert len(understood) > 200 and {"arm", "disarm", "hold", "surface"} <= {verb for _, verb, _ in station.given}
    assert station.hears()
