"""What is said: equal messages give equal bytes, and no bytes are believed that are not a message."""

import math
from typing import Any

import msgpack
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.core import messages, step_io
from agent.core.codec import Refusal, decode, encode, encoding
from agent.core.linear_algebra import upper
from agent.core.messages import MAX_PAYLOAD, SCHEMA, Estimate, LogLine, Message, NeighbourState, State
from agent.core.step_io import (
    DroppedPayloads,
    Heard,
    Inputs,
    Outputs,
    SetPoint,
    Sighting,
    SweepOutcome,
    SweepPlan,
    Telemetry,
)

ESTIMATE = Estimate(
    fleet="tank",
    src="r1",
    dst="r2",
    incarnation=1,
    seq=2,
    sent_ns=1_700_000_000_123_456_789,
    target="ball",
    t=3,
    valid=True,
    x_m=(0.1, -0.2, 1e-9),
    cov_m2=(1.0, 0.0, 0.0, 2.0, 0.0, 3.0),
)
STATE = State(
    fleet="tank",
    robot="r1",
    incarnation=1,
    seq=2,
    sent_ns=3,
    target="ball",
    knows="told",
    t=4,
    neighbours=(NeighbourState(robot="r2", age_s=0.1, valid=True),),
    refused={"too large": 2},
)
LINE = LogLine(robot="r1", sent_ns=1, level="warning", text="water in the hull")
SIGHTING = Sighting(t_ns=1, frame=2, target="ball", found=True, centre_px=(1.5, 2.5), clarity=3.0)
TELEMETRY = Telemetry(
    t_ns=1,
    board_us=2,
    depth_m=0.4,
    roll_deg=0.1,
    pitch_deg=-0.1,
    sensor_depth_m=(0.4, 0.4, 0.4, 0.4),
    pulses_us=(1500,) * 8,
    servos_us=(1500,) * 4,
    battery_v=12.0,
    armed=True,
    ladder=0,
    flags=0,
    loop_us=900,
)
INPUTS = Inputs(
    telemetry=(TELEMETRY,),
    sightings=(SIGHTING,),
    heard=(Heard(arrived_ns=1, src="r2", payload=b"\x00\xff"),),
    refused=(DroppedPayloads(reason="too large", count=1),),
)
OUTPUTS = Outputs(
    set_point=SetPoint(depth_m=0.4),
    sweep=SweepPlan(sweep=1, focus=(5, 4, 3)),
    says=(ESTIMATE,),
    state=STATE,
    log=(LINE,),
)
SWEPT = msgspec.structs.replace(OUTPUTS, outcome=SweepOutcome(sweep=1, target="ball", rejected="flat"))
SENT = [ESTIMATE, STATE, LINE]


@pytest.mark.parametrize("message", [*SENT, INPUTS, OUTPUTS, SWEPT], ids=lambda message: type(message).__name__)
def test_a_message_comes_back_as_it_was_said(message: Message) -> None:
    payload = encode(message)
    assert decode(payload, type(message)) == message
    assert encode(decode(payload, type(message))) == payload


def test_outputs_of_a_step_in_which_no_sweep_ended_do_not_speak_of_one() -> None:
    assert "outcome" not in msgpack.unpackb(encode(OUTPUTS))
    assert not decode(encode(OUTPUTS), Outputs).outcome


def test_nested_bytes_stay_bytes() -> None:
    assert decode(encode(INPUTS), Inputs).heard[0].payload == b"\x00\xff"


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_none_is_neither_said_nor_believed(bad: float) -> None:
    with pytest.raises(ValueError, match="x_m is not finite"):
        msgspec.structs.replace(ESTIMATE, x_m=(0.0, bad, 0.0))
    with pytest.raises(Refusal, match="x_m is not finite"):
        decode(payload(x_m=(0.0, bad, 0.0)), Estimate)


def payload(without: str = "", **changes: Any) -> bytes:
    fields = {**msgspec.to_builtins(ESTIMATE), **changes}
    fields.pop(without, None)
    return bytes(msgpack.packb(fields))


@pytest.mark.parametrize(
    ("bytes_", "reason"),
    [
        (b"", "msgpack"),
        (b"\xc1", "msgpack"),
        (b"\x93\x01\x02", "msgpack"),  # an array that ends early
        (payload() + b"\x00", "msgpack"),  # something after the message
        (bytes(msgpack.packb([1, 2])), "map"),
        (bytes(msgpack.packb({1: 2})), "msgpack"),
        (payload(schema=SCHEMA + 1), "schema"),
        (payload(without="schema"), "schema"),
        (payload(without="seq"), "seq"),
        (payload(opinion=1), "opinion"),
        (payload(seq=-1), "seq"),
        (payload(seq="1"), "seq"),
        (payload(src="R1"), "src"),
        (payload(src="r1\n"), "src"),
        (payload(src="r1/r2"), "src"),
        (payload(x_m=(1.0, 2.0)), "x_m"),
        (payload(cov_m2=(1.0,) * 9), "cov_m2"),
        (payload(valid=1), "valid"),
        (payload(target="b" * 17), "target"),
    ],
)
def test_what_is_no_message_is_refused_with_a_reason(bytes_: bytes, reason: str) -> None:
    with pytest.raises(Refusal, match=reason):
        decode(bytes_, Estimate)


def test_a_long_payload_is_refused_before_it_is_decoded() -> None:
    with pytest.raises(Refusal, match=f"{MAX_PAYLOAD + 1} bytes"):
        decode(bytes(MAX_PAYLOAD + 1), Estimate)


@settings(deadline=None)
@given(st.binary(max_size=300))
def test_no_bytes_do_more_harm_than_a_refusal(bytes_: bytes) -> None:
    with pytest.raises(Refusal):
        decode(bytes_, Estimate)


@settings(deadline=None)
@given(st.integers(0, len(encode(ESTIMATE)) - 1), st.integers(0, 255))
def test_a_changed_byte_gives_a_message_or_a_refusal(place: int, value: int) -> None:
    changed = bytearray(encode(ESTIMATE))
    changed[place] = value
    try:
        message = decode(bytes(changed), Estimate)
    except Refusal:
        return
    assert decode(encode(message), Estimate) == message


@pytest.mark.parametrize("message", SENT, ids=lambda message: type(message).__name__)
def test_what_is_sent_fits(message: Message) -> None:
    assert len(encode(message)) < MAX_PAYLOAD / 8


def test_each_kind_has_its_own_encoding() -> None:
    named = {**vars(messages), **vars(step_io)}.values()
    kinds = [kind for kind in named if isinstance(kind, type) and issubclass(kind, Message)]
    assert len({encoding(kind) for kind in kinds}) == len(kinds) > 10
    assert encoding(Estimate) == "application/msgpack;aucamp.Estimate"


def test_upper_is_the_upper_triangle_by_rows() -> None:
    assert upper([[1, 2, 3], [2, 4, 5], [3, 5, 6]]) == (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
