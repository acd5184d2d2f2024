"""Differences between messages, whatever a damaged recording holds in their place."""

from __future__ import annotations

import sys

import msgpack

from replay.check.compare import differences
from replay.check.reexecute import Divergence


def test_what_nests_deeper_than_python_writes_is_told_in_one_short_line():
    recorded = b"\x91" * 1020 + b"\x02"  # lists in lists: msgpack reads 1024 of them
    try:
        msgpack.unpackb(recorded)
    except ValueError as error:
        raise AssertionError("the case has to be one that msgpack reads") from error
    assert sys.getrecursionlimit() <= 1020, "and one that Python does not write"
    for replayed in (3, [4], {"a": 5}):
        (difference,) = differences(recorded, msgpack.packb(replayed))
        assert "beyond what can be shown" in str(difference) and len(str(difference)) < 300


def test_its_json_form_is_written_too():
    (difference,) = differences(b"\x91" * 1020 + b"\x02", msgpack.packb(3))
    assert "beyond what can be shown" in Divergence("r1", 1, 2, difference, ()).as_json()["recorded"]
