"""A walk through one MCAP file, whatever its bytes are: its records in order, and what in it cannot be believed.

No length in the file is believed before it is known to lie within the file and within LARGEST, so that a corrupt one
costs no memory. All checksums of the format are checked, and our own digests (digests.py).
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from agent.core.config import ConfigError
from replay.files.mcap_audit import Audit, Damage

__all__ = ["Attachment", "Channel", "Damage", "Message", "Metadata", "Schema", "Tear", "records", "run_note"]

LARGEST = 32 * 1024 * 1024  # bytes of a record, and of what a chunk holds: a longer one is a corrupt length
MAGIC = b"\x89MCAP0\r\n"
HEAD = struct.Struct("<BQ")  # of every record: opcode, length of what follows
MESSAGE = struct.Struct("<HIQQ")  # of a message: channel, sequence, log time, publish time; its data follow
INDEX, PLACE = struct.Struct("<HI"), struct.Struct("<QQ")  # an index: channel, bytes that follow: time and place, ...
KINDS: dict[int, Any] = {
    kind_of: kind
    for kind_of, kind in (
        (Opcode.HEADER, Header),
        (Opcode.FOOTER, Footer),
        (Opcode.SCHEMA, Schema),
        (Opcode.CHANNEL, Channel),
        (Opcode.CHUNK, Chunk),
        (Opcode.MESSAGE_INDEX, MessageIndex),
        (Opcode.CHUNK_INDEX, ChunkIndex),
        (Opcode.ATTACHMENT, Attachment),
        (Opcode.ATTACHMENT_INDEX, AttachmentIndex),
        (Opcode.STATISTICS, Statistics),
        (Opcode.METADATA, Metadata),
        (Opcode.METADATA_INDEX, MetadataIndex),
        (Opcode.SUMMARY_OFFSET, SummaryOffset),
        (Opcode.DATA_END, DataEnd),
    )
}
BROKEN = (McapError, ValueError, struct.error, zstandard.ZstdError, MemoryError, OverflowError)

Kept = Schema | Channel | Message | Metadata | Attachment


class Tear(NamedTuple):
    """A stretch of the file that cannot be believed: an unfinished end, or a record that contradicts itself."""

    offset: int
    bytes: int


def records(path: Path) -> Iterator[Kept | Tear | Damage]:
    """What is in the data section in the order of the file, chunks opened; what is broken comes as a Tear.

    After a broken record the walk goes on where its length says that the next one begins; a length that cannot be ends
    it. What is whole but not as it was written comes as a Damage. Of a file that grows meanwhile, what was there
    at the beginning is read. Raises ConfigError if the file cannot be opened or is no MCAP file.
    """
    with _opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        magic = file.read(len(MAGIC))
        if not MAGIC.startswith(magic):  # less than that: its writer was killed at once
            raise ConfigError(f"{path}: is no recording; give a file that ends in .mcap or .mcap.active")
        if len(magic) < len(MAGIC):
            yield Tear(0, size)
            return
        yield from _walk(file, size)


def run_note(path: Path) -> tuple[dict[str, str], bool]:
    """The entries of `aucamp.run`, read from the head of the file alone, and whether all was sound until there."""
    sound = True
    for record in records(path):
        if isinstance(record, Metadata) and record.name == "aucamp.run":
            return record.metadata, sound
        sound = sound and not isinstance(record, Tear)
    return {}, sound


def _opened(path: Path) -> IO[bytes]:
    try:
        return path.open("rb")
    except OSError as error:
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; give a recording in it, such as {path / 'r1.mcap'}") from None
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give the path of a recording") from None


def _walk(file: IO[bytes], size: int) -> Iterator[Kept | Tear | Damage]:
    """The records behind the magic bytes, and at the end what the audit of all of them found."""
    audit, digest, crc = Audit(), sha256(MAGIC), zlib.crc32(MAGIC)
    offset = len(MAGIC)
    while offset < size:
        head = file.read(HEAD.size)
        opcode, length = HEAD.unpack(head) if len(head) == HEAD.size else (0, size)
        end = offset + HEAD.size + length
        content = file.read(length) if length <= LARGEST and end <= size else b""
        if end > size or length > LARGEST or len(content) < length:
            yield from audit.found
            yield Tear(offset, size - offset)
            return
        try:
            record = parsed(opcode, content)
            inside = audited(audit, record, offset, content, digest.hexdigest, crc)
        except BROKEN:
            audit.torn = True
            yield Tear(offset, end - offset)
        else:
            yield from inside
            if isinstance(record, Footer):
                yield from _after_footer(file, end, size, audit)
                return
        digest.update(head)
        digest.update(content)
        crc, offset = zlib.crc32(content, zlib.crc32(head, crc)), end
        audit.end_of(opcode, head, content)
    yield from audit.found
    yield Tear(size, 0)


def audited(
    audit: Audit, record: Any, offset: int, content: bytes, digest: Callable[[], str], crc: int
) -> Iterator[Kept] | tuple[Kept, ...]:
    """Show a record to the audit; what of it concerns a reader. `digest` and `crc` are of all bytes before it."""
    match record:
        case Chunk():
            inside = opened(record)
            audit.chunk(record, offset, HEAD.size + len(content), inside)
            return tuple(each for _, each in inside)
        case Attachment():
            audit.attachment(record, offset, content)
            return (record,)
        case Metadata():
            audit.note(record, offset, HEAD.size + len(content), digest)
            return (record,)
        case Schema() | Channel() | Message() if not audit.over:
            audit.loose(record)
            return (record,)
        case _:
            audit.other(record, offset, HEAD.size + len(content), crc)
            return ()


def _after_footer(file: IO[bytes], end: int, size: int, audit: Audit) -> Iterator[Tear | Damage]:
    tail = file.read(len(MAGIC))
    if tail != MAGIC:
        audit.torn = True
        yield from audit.found
        yield Tear(end, size - end)
        return
    if size > end + len(MAGIC):
        audit.add(f"{size - end - len(MAGIC)} bytes follow its end")
    yield from audit.verdict()


class _Exact(ReadDataStream):
    """The bytes of one record: mcap takes a short read for a whole one."""

    def read(self, length: int) -> bytes:
        data: bytes = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parsed(opcode: int, content: bytes) -> Any:
    """A record of the format. Raises one of BROKEN for one that is not of its length, or of no known kind."""
    if opcode == Opcode.MESSAGE:
        return message(content, 0, len(content))
    if opcode == Opcode.MESSAGE_INDEX:  # there are as many as channels in each chunk, and mcap's own reader is slow
        channel, length = INDEX.unpack_from(content)
        if length != len(content) - INDEX.size:
            raise ValueError("an index of messages of another length than it says")
        return MessageIndex(channel, list(PLACE.iter_unpack(content[INDEX.size :])))
    stream = _Exact(BytesIO(content))
    record = KINDS[opcode].read(stream) if opcode in KINDS else None
    if record is None or stream.count != len(content):
        raise ValueError(f"a record with opcode {opcode} and {len(content)} bytes")
    return record


def message(data: bytes, start: int, end: int) -> Message:
    """The message between two places."""
    if end - start < MESSAGE.size:
        raise ValueError("a message shorter than its head")
    channel, sequence, log_time, publish_time = MESSAGE.unpack_from(data, start)
    return Message(channel, log_time, data[start + MESSAGE.size : end], publish_time, sequence)


def opened(chunk: Chunk) -> list[tuple[int, Schema | Channel | Message]]:
    """The records of a chunk, each with its place in it. Raises one of BROKEN, also for a wrong checksum."""
    data = _uncompressed(chunk)
    if chunk.uncompressed_crc != 0 and zlib.crc32(data) != chunk.uncompressed_crc:
        raise ValueError("a chunk that contradicts its checksum")
    found: list[tuple[int, Schema | Channel | Message]] = []
    offset = 0
    while offset < len(data):
        opcode, length = HEAD.unpack_from(data, offset)
        start, end = offset + HEAD.size, offset + HEAD.size + length
        if end > len(data) or opcode not in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL):
            raise ValueError("a chunk with another record in it")
        is_message = opcode == Opcode.MESSAGE
        found.append((offset, message(data, start, end) if is_message else parsed(opcode, data[start:end])))
        offset = end
    return found


def _uncompressed(chunk: Chunk) -> bytes:
    """What a chunk holds, never more than it says, nor than LARGEST."""
    size = chunk.uncompressed_size
    if size > LARGEST or chunk.compression not in ("", "zstd"):
        raise ValueError(f"a chunk of {size} bytes, compressed by '{chunk.compression}'")
    data: bytes = chunk.data
    if chunk.compression:
        if zstandard.frame_content_size(data) not in (-1, size):
            raise ValueError("a chunk of another size than it says")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    if len(data) != size:
        raise ValueError("a chunk of another size than it says")
    return data
