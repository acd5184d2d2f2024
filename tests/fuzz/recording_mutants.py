"""Recordings that went wrong: bytes that were changed where they lay, and files that somebody wrote anew.

The first kind breaks checksums, as disks and networks do. The second has right checksums, and with `digests` right
digests too: what its reader must withstand is the content.
"""

from __future__ import annotations

import random
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import msgpack
from mcap.writer import CompressionType, Writer

from replay.files.channels import BEFORE, OWN, HashedFile, of_attachments, stamped
from replay.files.mcap_walk import Attachment, Channel, Message, Metadata, Schema, records

CHUNK_BYTES = 16 * 1024
HUGE = (0, 1, 2**15, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**60, 2**63 - 1, 2**63, 2**64 - 1)
FLOATS = (0.0, -0.0, 1e-320, 1e-9, -1.0, 1e3, 1e9, 1e30, 1e154, 1e300, -1e308, float("nan"), float("inf"))
TEXTS = ("", "r1", "r9", "black box", "fleet", "1", "-1", "2", "1e9", "é" * 40, "[", "[[a", "x" * 5000, "\x00", "{}")
Mutation = Callable[[random.Random, bytes], bytes]


def flipped(chance: random.Random, data: bytes) -> bytes:
    """Some bits are others."""
    out = bytearray(data)
    for _ in range(chance.choice((1, 1, 1, 2, 8, 64))):
        out[chance.randrange(len(out))] ^= 1 << chance.randrange(8)
    return bytes(out)


def cut(chance: random.Random, data: bytes) -> bytes:
    """Its end is missing, or something from the middle."""
    first, second = sorted(chance.randrange(len(data)) for _ in range(2))
    return data[:second] if chance.random() < 0.6 else data[:first] + data[second:]


def blocks(chance: random.Random, data: bytes) -> bytes:
    """A block is somewhere else, there twice, zero, or noise."""
    size = chance.choice((1, 8, 64, 512, 4096))
    start, other = (chance.randrange(max(1, len(data) - size)) for _ in range(2))
    block = data[start : start + size]
    match chance.randrange(4):
        case 0:
            swapped = data[:start] + data[other : other + size] + data[start + size :]
            return swapped[:other] + block + swapped[other + size :]
        case 1:
            return data[:other] + block + data[other:]
        case 2:
            return data[:start] + bytes(len(block)) + data[start + size :]
        case _:
            return data[:start] + chance.randbytes(len(block)) + data[start + size :]


def lengths(chance: random.Random, data: bytes) -> bytes:
    """A number somewhere is enormous, or off by one: often it is a length."""
    width, form = chance.choice(((4, "<I"), (8, "<Q")))
    at = chance.choice(_heads(data)) + 1 if chance.random() < 0.5 else chance.randrange(len(data) - 8)
    (now,) = struct.unpack_from(form, data, at)
    value = chance.choice((*HUGE, now + 1, now - 1)) % 2 ** (8 * width)
    return data[:at] + struct.pack(form, value) + data[at + width :]


BYTES: tuple[Mutation, ...] = (flipped, cut, blocks, lengths)


def _heads(data: bytes) -> list[int]:
    """Where records begin."""
    found, at = [], 8
    while at + 9 < len(data):
        found.append(at)
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return found


def rewritten(chance: random.Random, source: Path, out: Path, digests: bool) -> None:
    """Write a recording anew, some of its records changed. With `digests` in the shape of today's recordings."""
    there = list(records(source))
    chosen = {chance.randrange(len(there)) for _ in range(chance.choice((1, 1, 2, 5)))}
    attached = {each.name: each.data for each in there if isinstance(each, Attachment)}
    for number in chosen:
        each = there[number]
        if isinstance(each, Attachment):
            attached[each.name] = other_bytes(chance, each.data)
    with out.open("wb") as file:
        hashed = HashedFile(file)
        writer = Writer(hashed, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=digests)  # type: ignore[arg-type]
        writer.start(library="fuzz")
        channels: dict[int, int] = {}
        for number, record in enumerate(there):
            changed = number in chosen
            match record:
                case Metadata():
                    _note(chance, writer, hashed, record, attached, changed, digests)
                case Attachment():
                    writer.add_attachment(0, 0, record.name, record.media_type, attached[record.name])
                case Channel():
                    topic = chance.choice(("/raw/step_in", "/zenoh/x", "", record.topic)) if changed else record.topic
                    channels[record.id] = writer.register_channel(topic, record.message_encoding, 0, record.metadata)
                case Schema():
                    writer.register_schema(record.name, record.encoding, record.data)
                case Message():
                    _message(chance, writer, channels[record.channel_id], record, changed)
        writer.finish()


def _note(
    chance: random.Random,
    writer: Any,
    hashed: HashedFile,
    note: Metadata,
    attached: dict[str, bytes],
    changed: bool,
    digests: bool,
) -> None:
    facts = {key: value for key, value in note.metadata.items() if key not in (OWN, BEFORE)}
    facts = {key: value for key, value in facts.items() if not key.startswith("sha256.")}
    if changed and facts:
        key = chance.choice(list(facts))
        facts[key] = chance.choice((*TEXTS, str(chance.choice(HUGE)), facts[key][::-1]))
        if chance.random() < 0.2:
            del facts[key]
    if digests:
        texts = {name: data.decode(errors="replace") for name, data in attached.items()}
        if note.name == "aucamp.run":
            facts |= of_attachments(texts)
        if note.name in ("aucamp.end", "aucamp.recovered"):
            writer.flush()
            facts[BEFORE] = hashed.before
        facts = stamped(note.name, facts)
    writer.add_metadata(note.name, facts)


def _message(chance: random.Random, writer: Any, channel: int, message: Message, changed: bool) -> None:
    data, log_time, sequence = message.data, message.log_time, message.sequence
    if changed:
        match chance.randrange(6):
            case 0:
                log_time = chance.choice(HUGE) % 2**64
            case 1:
                sequence = chance.choice(HUGE) % 2**32
            case _:
                data = other_bytes(chance, data)
    for _ in range(chance.choice((1, 1, 1, 0, 2)) if changed else 1):
        writer.add_message(channel, log_time, data, message.publish_time, sequence)


def other_bytes(chance: random.Random, data: bytes) -> bytes:
    """Bytes in place of these: broken ones, or a map with another value somewhere in it."""
    try:
        fields = msgpack.unpackb(data)
    except (ValueError, TypeError, msgpack.UnpackException, RecursionError):
        fields = None
    if isinstance(fields, dict) and chance.random() < 0.8:
        try:
            return bytes(msgpack.packb(_other(chance, fields)))
        except (ValueError, TypeError, OverflowError):
            pass
    match chance.randrange(6):
        case 0:
            return b""
        case 1:
            return chance.randbytes(chance.randrange(200))
        case 2:
            return b"\x81\xa6schema" + b"\x91" * chance.randrange(2000) + b"\xc0"
        case 3:
            return b"\xdd" + struct.pack(">I", 2**32 - 1) + data
    return chance.choice(BYTES)(chance, data) if len(data) > 16 else data + b"x"


def _other(chance: random.Random, value: Any) -> Any:
    """A copy of a value in which one leaf, or the shape around it, is another."""
    if isinstance(value, dict) and value:
        key = chance.choice(list(value))
        if chance.random() < 0.1:
            return {name: each for name, each in value.items() if name != key}
        if chance.random() < 0.05:
            return {**value, "new": chance.choice(HUGE)}
        return {**value, key: _other(chance, value[key])}
    if isinstance(value, list) and value:
        at = chance.randrange(len(value))
        if chance.random() < 0.2:
            return value * chance.choice((0, 2, 64))
        return [*value[:at], _other(chance, value[at]), *value[at + 1 :]]
    return chance.choice(_leaves(value, chance))


def _leaves(value: Any, chance: random.Random) -> Sequence[Any]:
    if chance.random() < 0.1:
        return (None, True, [], {}, "", b"", 0, -1, [None] * 40)
    if isinstance(value, bool):
        return (not value,)
    if isinstance(value, float):
        return (*FLOATS, value * 2, value + 1e-12)
    if isinstance(value, int):
        return (*HUGE, value + 1, value - 1, -value)
    if isinstance(value, str):
        return TEXTS
    if isinstance(value, bytes):
        return (other_bytes(chance, value), value[: len(value) // 2])
    return (0, 1.0, "x", [1], {"a": 1})
