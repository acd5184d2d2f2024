"""The driver's half of the tether under whatever a board, or something in its place, may say."""

from __future__ import annotations

import random

from agent.core.codec import decode, encode
from agent.core.step_io import Inputs, SetPoint
from hw.firmware import parameters, wire
from hw.stm32.protocol import HostProtocol
from tests.fuzz.wire_frames import frame, mutated, noise, random_fields

UPWARDS = (wire.TELEM, wire.TELEM_1, wire.STATUS, wire.EVENT, wire.LOG, wire.HELLO_ACK, wire.ACK, wire.PARAM_VALUE)
STEP_NS = 20_000_000


def run(count: int, seed: int) -> None:
    """Let `count` streams arrive. AssertionError with the seed, the number of the stream and its bytes at the first
    that raises, or that leaves telemetry which no recording could be read with."""
    rng = random.Random(seed)
    host, writer, telemetry = HostProtocol(7), wire.Writer(), 0
    for number in range(count):
        now_ns = (number + 1) * STEP_NS
        stream = _stream(rng, writer, host)
        try:
            host.receive(stream, now_ns)
            _ask(rng, host)
            host.due(now_ns)
            telemetry += len(host.telemetry)
            inputs = Inputs(telemetry=tuple(host.telemetry))
            assert decode(encode(inputs), Inputs) == inputs
        except Exception as error:
            raise AssertionError(f"seed {seed}, stream {number}, {stream.hex()}: {error!r}") from error
        host.telemetry.clear()
        host.lines.clear()
    assert telemetry > 0 or count < 1000, "nothing came through: this tests the wrong thing"


def _stream(rng: random.Random, writer: wire.Writer, host: HostProtocol) -> bytes:
    if (chance := rng.random()) < 0.1:
        return noise(rng)
    kind = rng.choice(UPWARDS)
    fields = random_fields(rng, kind)
    if kind == wire.HELLO_ACK and chance < 0.8:
        version = rng.choice((wire.OLDEST, wire.PROTOCOL))
        fields = (version, wire.schema_crc(version), *fields[2:8], len(parameters.TABLE), fields[9])
    elif kind in (wire.TELEM, wire.TELEM_1) and chance < 0.8:
        fields = (*fields[:3], fields[3] | wire.FLAG_HELLO, *fields[4:])
    elif kind in (wire.ACK, wire.PARAM_VALUE) and chance < 0.8 and host._orders.current is not None:
        asked = host._orders.current
        fields = (asked.req_id, asked.kind, *fields[2:]) if kind == wire.ACK else (asked.req_id, *fields[1:])
    one = frame(writer, kind, fields)
    return mutated(rng, one) if rng.random() < 0.3 else one


def _ask(rng: random.Random, host: HostProtocol) -> None:
    """Orders and set-points of our own meanwhile, so that answers have something to be answers to."""
    match rng.randrange(12):
        case 0:
            host.ask(wire.PARAM_SET, rng.randrange(len(parameters.TABLE)), parameters.REAL, 0, 1.0)
        case 1:
            host.ask(wire.PARAM_LIST)
        case 2:
            host.arm()
        case 3:
            host.stop(rng.choice((wire.DISARM, wire.ESTOP)))
        case 4:
            host.hung_up()
        case 5:
            host.set_point(SetPoint(depth_m=0.3), 1)
