"""What a person sees of a payload."""

import json
import time

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.core.codec import encode
from agent.core.messages import LogLine
from agent.core.step_io import Heard
from agent.ground.schemas import decode


def test_a_message_is_one_line_of_json() -> None:
    line = decode("key", encode(LogLine(robot="r1", sent_ns=time.time_ns(), level="info", text="two\nlines")))
    assert "\n" not in line
    assert json.loads(line)["text"] == "two\nlines"


@pytest.mark.parametrize(
    ("payload", "shown"),
    [
        (
            encode(Heard(arrived_ns=1, src="r1", payload=bytes(9))),
            '{"arrived_ns": 1, "src": "r1", "payload": "<9 bytes>"}',
        ),
        (b"plain text", "plain text"),
        (b"7", "7"),
        (b"", ""),
        (b"two\nlines", '"two\\nlines"'),
        (b"\x1b[2Jclears the screen", '"\\u001b[2Jclears the screen"'),
        ("tiefe 3 µm".encode(), '"tiefe 3 \\u00b5m"'),
        (b"\xff\xd8\xff\xe0" + bytes(6), "<jpeg 10 bytes>"),
        (b"\xc1\xff", "<2 bytes>"),
    ],
)
def test_the_rest_is_shown_by_what_it_is(payload: bytes, shown: str) -> None:
    assert decode("key", payload) == shown


@given(st.binary(max_size=200))
def test_no_bytes_raise_or_break_the_line(payload: bytes) -> None:
    assert decode("key", payload).isprintable()


nested = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text() | st.integers(0, 9) | st.binary(), inner),
    max_leaves=20,
)


@settings(max_examples=40, deadline=None)  # the nested maps are slow to draw
@given(st.dictionaries(st.text() | st.binary(), nested))
def test_no_map_raises_or_breaks_the_line(fields: dict[object, object]) -> None:
    assert decode("key", msgpack.packb(fields)).isprintable()
