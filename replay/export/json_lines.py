"""Every message of a recording as one line of JSON, decoded.

A line is {"file", "channel", "log_time_ns", "publish_time_ns", "sequence", "message"}. Bytes become {"base64": "..."},
but for messages of neighbours as they came into a step, which are decoded too. Of protobuf messages the fields have
their own names, bytes are base64, 64-bit integers are texts, and what is not a number is "NaN", as protobuf has it.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
from google.protobuf import descriptor_pb2, descriptor_pool, json_format, message_factory

from agent.core.config import ConfigError
from replay.export.source import recordings_of, whole_or_none
from replay.files.mcap_walk import Channel, Message, Schema, Tear, records
from replay.files.names import parts
from replay.files.suspect import suspecting

Decode = Callable[[bytes], Any]


def write_lines(path: Path, out: Path, robot: str | None = None, channels: Sequence[str] = ()) -> int:
    """Write the lines of a run's recordings, or of one recording, into the new file `out`, and return how many."""
    count = 0
    with whole_or_none(out), out.open("x", encoding="utf-8") as file:
        for line in lines(recordings_of(path), channels, robot):
            file.write(line + "\n")
            count += 1
        if not count:
            about = f"of a robot '{robot}'" if robot else "that can be read"
            raise ConfigError(f"{path}: has no message {about}; `aucamp replay info` says what is in it")
    return count


def lines(paths: Sequence[Path], channels: Sequence[str] = (), robot: str | None = None) -> Iterator[str]:
    """The lines of some recordings, in the order of the files. `channels`: only these; `robot`: only what is about it.

    Raises ConfigError for a channel that is in none of them, and for messages that do not decode.
    """
    seen: set[str] = set()
    for path in paths:
        for file in parts(path):
            with suspecting(file):
                yield from _of_file(file, channels, robot, seen)
    missing = [channel for channel in channels if channel not in seen]
    if missing:
        raise ConfigError(f"no channel {missing[0]} in {paths[0]}; `aucamp replay info` lists them")


def _of_file(file: Path, wanted: Sequence[str], robot: str | None, seen: set[str]) -> Iterator[str]:
    """Up to the first tear, as everybody reads a recording."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    decoders: dict[int, Decode] = {}
    for record in records(file):
        match record:
            case Schema():
                schemas[record.id] = record
            case Channel():
                channels[record.id] = record
                decoders[record.id] = _decoder(record, schemas.get(record.schema_id))
            case Message() if record.channel_id in channels:
                topic = channels[record.channel_id].topic
                seen.add(topic)
                if (wanted and topic not in wanted) or not _about(robot, topic, file):
                    continue
                facts = {
                    "file": file.name,
                    "channel": topic,
                    "log_time_ns": record.log_time,
                    "publish_time_ns": record.publish_time,
                    "sequence": record.sequence,
                    "message": decoders[record.channel_id](record.data),
                }
                yield json.dumps(facts, default=_plain)
            case Tear():
                return


def _about(robot: str | None, topic: str, file: Path) -> bool:
    """Whether a channel is about a robot: its own name is in that of the channel, or of the black box."""
    return robot is None or robot in topic.split("/") or file.name.split(".")[0] == robot


def _decoder(channel: Channel, schema: Schema | None) -> Decode:
    if channel.message_encoding == "msgpack":
        return _msgpack
    if channel.message_encoding == "json":
        return json.loads
    if channel.message_encoding == "protobuf" and schema is not None:
        return partial(_protobuf, _kind(schema))
    return _plain


def _msgpack(data: bytes) -> Any:
    message = msgspec.msgpack.decode(data)
    if isinstance(message, dict):
        for heard in message.get("heard", ()):  # of Inputs: what neighbours said
            if isinstance(heard, dict) and isinstance(heard.get("payload"), bytes):
                try:
                    heard["payload"] = msgspec.msgpack.decode(heard["payload"])
                except msgspec.DecodeError:
                    continue  # what came was no message: its bytes are shown
    return message


def _kind(schema: Schema) -> Any:
    """The class of a protobuf message, by nothing but the descriptor in the file."""
    pool = descriptor_pool.DescriptorPool()
    for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
        pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))


def _protobuf(kind: Any, data: bytes) -> Any:
    return json_format.MessageToDict(kind.FromString(data), preserving_proto_field_name=True)


def _plain(data: Any) -> Any:
    if isinstance(data, bytes):
        return {"base64": base64.b64encode(data).decode()}
    raise TypeError(f"{type(data).__name__} is not in our messages")
