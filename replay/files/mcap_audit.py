"""What a file says of itself at its end, held against what a walk through it met: index, counts, checksums, digests.

A file of ours has all of these. One that something else wrote is judged by the checksums alone, and one from before
digests by all but those.
"""

from __future__ import annotations

import struct
import zlib
from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from hashlib import sha256
from typing import Any, NamedTuple

from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Message,
    MessageIndex,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
)

from replay.files.digests import BEFORE, attached, is_as_written

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
