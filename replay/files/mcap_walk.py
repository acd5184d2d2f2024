"""A walk through one MCAP file, whatever its bytes are: its records in order, and what in it cannot be believed by
digests, counts and index.

No length in the file is believed before it is known to lie within the file and within LARGEST, so that a corrupt one
costs no memory. All checksums of the format are checked, and our own digests.
"""

from __future__ import annotations

import os
import re
import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
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
from agent.core.picture_head import kind_of
from replay.files.channels import BEFORE, attached, is_as_written

# --- audit of the end of a file ---
# What a file says of itself at its end, held against what a walk through it met: index, counts, checksums, digests.
#
# A file of ours has all of these. One that something else wrote, or copied, is judged by the checksums alone and by the
# digests of header and attachments, and one from before digests by all but those.

OURS = "aucamp"  # what the header says of its library begins with this
RUN, LAST = "aucamp.run", ("aucamp.end", "aucamp.recovered")
DAMAGED = "damaged"  # entry of the last note of a mended copy: what of the damage is in the copy, too
ATTACHMENT_BYTES = 8 + 8 + 4 + 4 + 8  # of times and lengths; name, kind and data are beside
SUMMARY_HEAD = struct.Struct("<BQQQ")  # what of the footer is in the checksum of the summary


class Damage(NamedTuple):
    """Something that is whole and not as it was written."""

    what: str
    lasts: bool = False  # a mended copy has it too: it is in what was recorded, not in how it is stored
    bytes: int = 0  # that no mended copy has


class Audit:
    """Is shown each record of a file in turn; `verdict` is asked once, at the end of a file that has one."""

    def __init__(self) -> None:
        self.found: list[Damage] = []
        self.torn = False  # some record was broken: counts and digests of the whole must differ
        self.over = False  # the data section has ended
        self.ours = True  # no other program has copied it, which orders and indexes it anew
        self._run: dict[str, str] | None = None
        self._closed = False  # the last note has been
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()
        self._times: list[int] = []  # earliest and latest
        self._chunks: list[ChunkIndex] = []
        self._due: dict[int, list[tuple[int, int]]] = {}  # message indexes of the chunk before, by channel
        self._notes: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._told: defaultdict[type, list[Any]] = defaultdict(list)  # records of the summary
        self._summary_crc, self._summary_start, self._footer_bytes = 0, 0, 0
        self._nameless = 0

    def add(self, what: str, lasts: bool = False, lost: int = 0) -> None:
        """Note a damage."""
        self.found.append(Damage(what, lasts, lost))

    def header(self, record: Header) -> None:
        """The first record."""
        self.ours = record.library.startswith(OURS)

    def chunk(self, chunk: Chunk, offset: int, length: int, inside: Sequence[tuple[int, Any]]) -> None:
        """A chunk and the records in it, by their places."""
        self._late()
        self._end_chunk()
        due: defaultdict[int, list[tuple[int, int]]] = defaultdict(list)
        for place, record in inside:
            self.loose(record)
            if isinstance(record, Message):
                due[record.channel_id].append((record.log_time, place))
        self._due = dict(due)
        times = [time for entries in due.values() for time, _ in entries]
        if times and (min(times), max(times)) != (chunk.message_start_time, chunk.message_end_time):
            self.add("a chunk has other times than its messages")
        self._chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=0,
                message_index_offsets={},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def loose(self, record: Schema | Channel | Message) -> None:
        """A message, or what describes messages, in a chunk or beside."""
        if isinstance(record, Message):
            self._counts[record.channel_id] += 1
            if record.channel_id not in self._channels:
                self._nameless += 1
            if not self._times:
                self._times = [record.log_time, record.log_time]
            elif record.log_time < self._times[0]:
                self._times[0] = record.log_time
            elif record.log_time > self._times[1]:
                self._times[1] = record.log_time
            return
        known: dict[int, Any] = self._schemas if isinstance(record, Schema) else self._channels
        if known.setdefault(record.id, record) != record:
            self.add(f"two {'schemas' if isinstance(record, Schema) else 'channels'} have the number {record.id}", True)

    def attachment(self, record: Attachment, offset: int, content: bytes) -> None:
        """An attachment; in `content` its checksum follows the fields."""
        self._late()
        fields = ATTACHMENT_BYTES + len(record.name.encode()) + len(record.media_type.encode()) + len(record.data)
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=9 + len(content),
                log_time=record.log_time,
                create_time=record.create_time,
                data_size=len(record.data),
                name=record.name,
                media_type=record.media_type,
            )
        )
        (crc,) = struct.unpack_from("<I", content, fields)
        said = attached(self._run or {}).get(record.name)
        if said is not None and said != sha256(record.data).hexdigest():
            self.add(f"{record.name} in it is not the file that was attached", True)
        elif crc not in (0, zlib.crc32(content[:fields])):
            self.add(f"{record.name} in it contradicts its checksum", said is None)

    def note(self, record: Metadata, offset: int, length: int, digest: Callable[[], str]) -> None:
        """A metadata record; `digest` is of all bytes before it."""
        self._late()
        if any(index.name == record.name for index in self._notes):
            self.add(f"{record.name} is in it twice", True)
        self._notes.append(MetadataIndex(offset=offset, length=length, name=record.name))
        if is_as_written(record.name, record.metadata) is False:
            self.add(f"{record.name} is not as it was written", record.name == RUN)
        elif record.name == RUN:
            self._run = record.metadata
        elif record.name in LAST:
            self._closed = BEFORE in record.metadata  # in older recordings the last messages follow it
            self._end_chunk()
            if record.metadata.get(DAMAGED):
                self.add(f"before it was mended {record.metadata[DAMAGED]}", True)
            changed = self.ours and record.metadata.get(BEFORE, digest()) != digest()
            if changed and not self.torn and not self.found:
                self.add("what was recorded was changed afterwards", True)

    def other(self, record: Any, offset: int, length: int, crc: int) -> None:
        """A record that is there to find others; `crc` is of all bytes before it."""
        if isinstance(record, MessageIndex) and not self.over:
            if sorted(record.records) != sorted(self._due.pop(record.channel_id, [])) or not self._chunks:
                self.add("an index of messages does not fit its chunk")
            if self._chunks:
                self._chunks[-1].message_index_offsets[record.channel_id] = offset
                self._chunks[-1].message_index_length += length
        elif isinstance(record, DataEnd) and not self.over:
            self._end_chunk()
            self.over, self._summary_start = True, offset + length
            if record.data_section_crc not in (0, crc) and not self.torn and not self.found:
                self.add("its data contradict their checksum")
        elif self.over or isinstance(record, Footer):
            self._told[type(record)].append(record)
            self._footer_bytes = length - HEAD.size

    def end_of(self, opcode: int, head: bytes, content: bytes) -> None:
        """All bytes of a record, also of one that could not be read, before the footer."""
        if self.over and opcode != Opcode.DATA_END:
            self._summary_crc = zlib.crc32(content, zlib.crc32(head, self._summary_crc))

    def verdict(self) -> list[Damage]:
        """All that was found, once the footer has been seen."""
        if self._nameless and not self.torn:
            self.add(f"{self._nameless} messages are on channels that it does not name", True)
        self._check_summary(self._told[Footer][-1])
        if self._run is not None and not self.torn:
            if self.ours:
                self._check_index()
            missing = set(attached(self._run)) - {each.name for each in self._attachments}
            for name in sorted(missing):
                self.add(f"{name} is no longer in it", True)
        return self.found

    def _check_summary(self, footer: Footer) -> None:
        head = SUMMARY_HEAD.pack(Opcode.FOOTER, self._footer_bytes, footer.summary_start, footer.summary_offset_start)
        if footer.summary_crc not in (0, zlib.crc32(head, self._summary_crc)):
            self.add("its index contradicts its checksum")
        elif footer.summary_start != (self._summary_start if len(self._told) > 1 else 0):
            self.add("its index is not where it says")

    def _check_index(self) -> None:
        """Whether index and counts are those of what is there."""
        start, end = self._times or (0, 0)
        counted = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=self._counts.total(),
            message_end_time=end,
            message_start_time=start,
            metadata_count=len(self._notes),
            schema_count=len(self._schemas),
        )
        there: dict[str, tuple[type, list[Any]]] = {
            "counts of messages": (Statistics, [counted]),
            "index of chunks": (ChunkIndex, self._chunks),
            "index of attachments": (AttachmentIndex, self._attachments),
            "index of notes": (MetadataIndex, self._notes),
            "list of channels": (Channel, list(self._channels.values())),
            "list of schemas": (Schema, list(self._schemas.values())),
        }
        for what, (kind, met) in there.items():
            if self._told[kind] != met:
                self.add(f"its {what} does not fit what is in it")

    def _end_chunk(self) -> None:
        if self._due and self._run is not None and self.ours:
            self.add("an index of messages is missing")
        self._due = {}

    def _late(self) -> None:
        """Nothing is recorded behind the last note."""
        if self._closed and self.ours:
            self.add("something follows its last note", True)


# --- the walk ---

__all__ = [
    "Attachment",
    "Channel",
    "Damage",
    "Header",
    "Message",
    "Metadata",
    "Schema",
    "Tear",
    "last_note",
    "records",
    "run_note",
]

LARGEST = 128 * 1024 * 1024  # bytes of a record, and of what a chunk holds: a longer one is a corrupt length
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
UNKNOWN = 0x10  # opcodes from here on are of versions to come, and of private kinds: a reader skips them
BROKEN = (McapError, ValueError, struct.error, zstandard.ZstdError, RuntimeError, MemoryError, OverflowError)

Kept = Header | Schema | Channel | Message | Metadata | Attachment


class Tear(NamedTuple):
    """A stretch of the file that cannot be believed: an unfinished end, or a record that contradicts itself."""

    offset: int
    bytes: int


def records(path: Path) -> Iterator[Kept | Tear | Damage]:
    """What is in the data section in the order of the file, chunks opened; what is broken comes as a Tear.

    After a broken record the walk goes on where its length says that the next one begins; where none does, with the
    next one that can be found. What is whole but not as it was written comes as a Damage. Of a file that grows
    meanwhile, what was there at the beginning is read. Raises ConfigError if the file cannot be opened or is no MCAP
    file.
    """
    with _opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        magic = file.read(len(MAGIC))
        if not MAGIC.startswith(magic):  # less than that: its writer was killed at once
            kind = kind_of(magic + file.read(64))
            what = f"it is {kind}" if kind else "its first bytes are not those of MCAP"
            raise ConfigError(f"{path}: is no recording: {what}; give a recording (MCAP)")
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


def last_note(path: Path) -> dict[str, str]:
    """The entries of `aucamp.end`, or of `aucamp.recovered` in a mended copy, read by the index of the file alone; none
    of a file without them, or without an index."""
    try:
        with path.open("rb") as file:
            notes = list(SeekingReader(file, record_size_limit=LARGEST).iter_metadata())
    except (*BROKEN, OSError, StopIteration):
        return {}
    return next((note.metadata for note in notes if note.name in LAST), {})


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
        head, content, end = _record(file, offset, size)
        try:
            if end is None:
                raise EndOfFile
            record = parsed(head[0], content, exact=audit.ours)
            inside = audited(audit, record, offset, content, digest.hexdigest, crc)
        except BROKEN:
            audit.torn = True
            after = end if end is not None and _begins(file, end, size) else _found(file, offset + 1, size)
            yield from audit.found if after == size else ()
            yield Tear(offset, after - offset)
            if after == size:
                return
            offset = after
            continue
        yield from inside
        if isinstance(record, Footer):
            file.seek(end)
            yield from _after_footer(file, end, size, audit)
            return
        digest.update(head)
        digest.update(content)
        crc, offset = zlib.crc32(content, zlib.crc32(head, crc)), end
        audit.end_of(head[0], head, content)
    yield from audit.found
    yield Tear(size, 0)


def _record(file: IO[bytes], offset: int, size: int) -> tuple[bytes, bytes, int | None]:
    """Head and content of what begins there, and where it ends; None: not within the file, or not within LARGEST."""
    file.seek(offset)
    head = file.read(HEAD.size)
    length = HEAD.unpack(head)[1] if len(head) == HEAD.size else size
    end = offset + HEAD.size + length
    content = file.read(length) if length <= LARGEST and end <= size else b""
    return head, content, end if length <= LARGEST and end <= size and len(content) == length else None


WINDOW = 2**20  # bytes that are searched at a time
LIKELY = re.compile(rb"[\x01-\x0f](?=.{4}\0{4})", re.DOTALL)  # a known opcode, and a length below 4 GiB


def _found(file: IO[bytes], start: int, size: int) -> int:
    """Where the next record begins that can be read, and that others follow; the size of the file if none does."""
    for place in range(start, size, WINDOW):
        file.seek(place)
        window = file.read(WINDOW + HEAD.size)
        for at in (place + likely.start() for likely in LIKELY.finditer(window)):
            if _begins(file, at, size) and _reads(file, at, size):
                return at
    return size


def _begins(file: IO[bytes], at: int, size: int) -> bool:
    """Whether there is the head of a record and of two behind it, or the end of the file."""
    for _ in range(3):
        if at == size:
            return True
        file.seek(at)
        head = file.read(HEAD.size)
        if head.startswith(MAGIC) or len(head) < HEAD.size:
            return head.startswith(MAGIC)
        opcode, length = HEAD.unpack(head)
        if opcode == 0 or at + HEAD.size + length > size:
            return False
        at += HEAD.size + length
    return True


def _reads(file: IO[bytes], at: int, size: int) -> bool:
    head, content, end = _record(file, at, size)
    try:
        record = parsed(head[0], content)
        if isinstance(record, Chunk):
            opened(record)
    except BROKEN:
        return False
    return end is not None


def audited(
    audit: Audit, record: Any, offset: int, content: bytes, digest: Callable[[], str], crc: int
) -> Iterator[Kept] | tuple[Kept, ...]:
    """Show a record to the audit; what of it concerns a reader. `digest` and `crc` are of all bytes before it."""
    match record:
        case None:
            return ()
        case Header():
            audit.header(record)
            return (record,)
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
    if (behind := size - end - len(MAGIC)) > 0:
        audit.add(f"{behind} bytes follow its end", lost=behind)
    yield from audit.verdict()


class _Exact(ReadDataStream):
    """The bytes of one record: mcap takes a short read for a whole one."""

    def read(self, length: int) -> bytes:
        data: bytes = super().read(length)
        if len(data) != length:
            raise EndOfFile
        return data


def parsed(opcode: int, content: bytes, exact: bool = False) -> Any:
    """A record of the format; None for one of a kind to come. What follows its fields is skipped, unless it is to be
    `exact`, as ours are. Raises one of BROKEN for one that is shorter than its fields, or of no kind."""
    if opcode >= UNKNOWN:
        return None
    if opcode == Opcode.MESSAGE:
        return message(content, 0, len(content))
    if opcode == Opcode.MESSAGE_INDEX:  # there are as many as channels in each chunk, and mcap's own reader is slow
        channel, length = INDEX.unpack_from(content)
        if length > len(content) - INDEX.size:
            raise ValueError("an index of messages longer than its record")
        return MessageIndex(channel, list(PLACE.iter_unpack(content[INDEX.size : INDEX.size + length])))
    if opcode not in KINDS:
        raise ValueError(f"a record with opcode {opcode}")
    stream = _Exact(BytesIO(content))
    record = KINDS[opcode].read(stream)
    if exact and opcode != Opcode.HEADER and stream.count != len(content):
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
        known = opcode in (Opcode.MESSAGE, Opcode.SCHEMA, Opcode.CHANNEL)
        if end > len(data) or not (known or opcode >= UNKNOWN):
            raise ValueError("a chunk with another record in it")
        if not known:
            offset = end
            continue
        is_message = opcode == Opcode.MESSAGE
        found.append((offset, message(data, start, end) if is_message else parsed(opcode, data[start:end])))
        offset = end
    return found


def _uncompressed(chunk: Chunk) -> bytes:
    """What a chunk holds, never more than it says, nor than LARGEST."""
    size = chunk.uncompressed_size
    if size > LARGEST or chunk.compression not in ("", "zstd", "lz4"):
        raise ValueError(f"a chunk of {size} bytes, compressed by '{chunk.compression}'")
    data: bytes = chunk.data
    if chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1) if size else b""
    elif chunk.compression:
        if zstandard.frame_content_size(data) not in (-1, size):
            raise ValueError("a chunk of another size than it says")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    if len(data) != size:
        raise ValueError("a chunk of another size than it says")
    return data
