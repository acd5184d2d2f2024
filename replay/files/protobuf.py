"""What our protobuf messages have in common, whoever makes them: how a file describes them, and how they say a time."""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.schema import build_file_descriptor_set

from replay.files.backlog import Schema


@cache
def schema(kind: Any) -> Schema:
    """What the file says about a protobuf class: its full name, and its descriptor with all that it imports."""
    return Schema(kind.DESCRIPTOR.full_name, "protobuf", build_file_descriptor_set(kind).SerializeToString())


def stamp(t_ns: int) -> Timestamp:
    return Timestamp(seconds=t_ns // 10**9, nanos=t_ns % 10**9)
