"""A walk through one MCAP file, whatever its bytes are: its records in order, and what in it cannot be believed by
digests, counts and index.

No length in the file is believed before it is known to lie within the file and within LARGEST, so that a corrupt one
costs no memory. All checksums of the format are checked, and our own digests.
"""

from __future__ import annotations

import json
import os
import struct
import traceback
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
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

from agent.core.codec import Refusal
from agent.core.config import ConfigError

# --- digests ---
# What a recording says of itself as SHA-256, so that a reader notices what was changed after it was written.
#
# The header `aucamp.run` has a digest of itself and of each attachment; every other note has its own. The last note
# has one of all bytes before it. A digest is no signature: who writes a whole new file writes new digests into it.

OWN = "sha256"  # entry of a note: digest of its name and its other entries
BEFORE = "sha256.before"  # entry of the last note: of all bytes of the file before that note
ATTACHED = "sha256."  # and the attachment's name: entry of the header


def stamped(name: str, facts: Mapping[str, object]) -> dict[str, str]:
    """The entries of a note as texts, its own digest among them."""
    entries = {key: str(value) for key, value in facts.items() if key != OWN}
    return {**entries, OWN: _digest(name, entries)}


def is_as_written(name: str, entries: Mapping[str, str]) -> bool | None:
    """Whether a note is what its digest says; None: it is older than digests."""
    said = entries.get(OWN)
    if said is None:
        return None
    return said == _digest(name, {key: value for key, value in entries.items() if key != OWN})


def of_attachments(attachments: Mapping[str, str]) -> dict[str, str]:
    """Entries of the header for texts by file name."""
    return {f"{ATTACHED}{name}": sha256(text.encode()).hexdigest() for name, text in attachments.items()}


def attached(run: Mapping[str, str]) -> dict[str, str]:
    """Digests of the attachments by file name, as a header has them."""
    return {key.removeprefix(ATTACHED): value for key, value in run.items() if key.startswith(ATTACHED)}


def _digest(name: str, entries: Mapping[str, str]) -> str:
    return sha256(json.dumps([name, sorted(entries.items())]).encode()).hexdigest()


class HashedFile:
    """A file that is written once from its beginning; `before` is the digest of what was written so far."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file, self._digest = file, sha256()

    def write(self, data: bytes) -> int:
        """Write and take into the digest."""
        self._digest.update(data)
        return self._file.write(data)

    def tell(self) -> int:
        """Where the next byte goes."""
        return self._file.tell()

    def flush(self) -> None:
        """Hand everything to the operating system."""
        self._file.flush()

    @property
    def before(self) -> str:
        return self._digest.hexdigest()


# --- audit of the end of a file ---
# What a file says of itself at its end, held against what a walk through it met: index, counts, checksums, digests.
#
# A file of ours has all of these. One that something else wrote is judged by the checksums alone, and one from before
# digests by all but those.

RUN, LAST = "aucamp.run", ("aucamp.end", "aucamp.recovered")
DAMAGED = "damaged"  # entry of the last note of a mended copy: what of the damage is in the copy, too
SUMMARY_HEAD = struct.Struct("<BQQQ")  # what of the footer is in the checksum of the summary


class Damage(NamedTuple):
    """Something that is whole and not as it was written."""

    what: str
    lasts: bool = False  # a mended copy has it too: it is in what was recorded, not in how it is stored


class Audit:
    """Is shown each record of a file in turn; `verdict` is asked once, at the end of a file that has one."""

    def __init__(self) -> None:
        self.found: list[Damage] = []
        self.torn = False  # some record was broken: counts and digests of the whole must differ
        self.over = False  # the data section has ended
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
        self._summary_crc, self._summary_start = 0, 0
        self._nameless = 0

    def add(self, what: str, lasts: bool = False) -> None:
        """Note a damage."""
        self.found.append(Damage(what, lasts))

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
        """An attachment; `content` ends with its checksum."""
        self._late()
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
        (crc,) = struct.unpack("<I", content[-4:])
        said = attached(self._run or {}).get(record.name)
        if said is not None and said != sha256(record.data).hexdigest():
            self.add(f"{record.name} in it is not the file that was attached", True)
        elif crc not in (0, zlib.crc32(content[:-4])):
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
            if record.metadata.get(BEFORE, digest()) != digest() and not self.torn and not self.found:
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
            self._check_index()
            missing = set(attached(self._run)) - {each.name for each in self._attachments}
            for name in sorted(missing):
                self.add(f"{name} is no longer in it", True)
        return self.found

    def _check_summary(self, footer: Footer) -> None:
        head = SUMMARY_HEAD.pack(Opcode.FOOTER, 20, footer.summary_start, footer.summary_offset_start)
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
        if self._due and self._run is not None:
            self.add("an index of messages is missing")
        self._due = {}

    def _late(self) -> None:
        """Nothing is recorded behind the last note."""
        if self._closed:
            self.add("something follows its last note", True)


# --- the walk ---

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


# --- damaged recordings ---
# What a recording can do to its reader: nothing but make it say, in one line, that it is damaged.
#
# Whoever reads checks what can be checked. What still goes wrong in bytes that no recorder of ours wrote ends here,
# with the place in our code that could not go on: if it is the code's mistake and not the file's, that is where to
# look.

PACKAGE = Path(__file__).parents[2]
MOST = 160  # characters of what was wrong
REMEDY = "take another copy of it, or report this line if its recorder is of this version"


@contextmanager
def suspecting(path: Path) -> Iterator[None]:
    """Raise ConfigError, one line that names the file, for whatever its content does to the code in this block.

    An OSError that names its own file comes through: it is about a disk.
    """
    try:
        yield
    except ConfigError:
        raise
    except Refusal as refusal:
        raise ConfigError(f"{path}: holds a message that is none ({refusal}); {REMEDY}") from None
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise
        said = " ".join(str(error).split())[:MOST]
        what = f"{type(error).__name__}{f': {said}' if said else ''}"
        raise ConfigError(f"{path}: holds what no recorder writes ({what}, in {_place(error)}); {REMEDY}") from error


def _place(error: Exception) -> str:
    """Where in our code it happened: file and line."""
    frames = [(Path(frame.filename), frame.lineno) for frame in traceback.extract_tb(error.__traceback__)]
    rooms = [PACKAGE / room for room in ("agent", "replay")]
    path, line = [each for each in frames if any(each[0].is_relative_to(room) for room in rooms)][-1]
    return f"{path.relative_to(PACKAGE)}:{line}"
