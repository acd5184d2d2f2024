"""One MCAP file: `Part` writes it, `records` walks through it, sound or torn. The only file that imports mcap.

NAME.mcap.active is being written, or its writer was killed; NAME.mcap has been finished and has a summary. Metadata
`aucamp.run` comes first, `aucamp.end` last; without the latter the end was not clean.
"""

from __future__ import annotations

import contextlib
import json
import os
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, NamedTuple

import zstandard
from mcap.exceptions import McapError
from mcap.reader import FOOTER_SIZE, SeekingReader
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import MAGIC_SIZE, StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from agent.kernel.config import ConfigError
from replay.files.backlog import Entry
from replay.files.environment import version
from replay.files.file_lock import hold, is_held
from replay.files.names import active

__all__ = ["Attachment", "Channel", "Message", "Metadata", "Part", "Schema", "Summary", "Tear", "records", "summary"]

CHUNK_BYTES = 256 * 1024  # the format's default, 1 MiB, is minutes of telemetry: all lost when the process is killed
RECORD_BYTES = 64 * 1024 * 1024  # a longer record is a corrupt length
SHORTEST = 2 * MAGIC_SIZE + FOOTER_SIZE  # of a finished file


class Part:
    """One file under construction. Not for several threads. OSError comes through: the caller knows what to stop."""

    def __init__(self, path: Path) -> None:
        """Create the file. Raises ConfigError if it cannot be created, or if there is one already."""
        if path.is_dir():
            raise ConfigError(f"{path}: is a folder; give the name of a file in it")
        if is_held(active(path)):
            raise ConfigError(f"{active(path)}: is being written by another process; give another name")
        for taken in (path, active(path)):
            if taken.exists():
                raise ConfigError(f"{taken}: exists already; give another name or move it away")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[bytes] = active(path).open("xb")
        except OSError as error:
            raise ConfigError(f"{active(path)}: cannot be written: {error.strerror}; give another place") from None
        hold(self._file)
        self.path = path
        self._writer: Any = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._last: dict[str, int] = {}  # newest sequence number, by channel
        self._sound = 0  # bytes of whole records

    def start(self, run: Mapping[str, object], attachments: Mapping[str, str]) -> None:
        """Write and flush what stands at the head of the file. `attachments` are texts by file name."""
        self._writer.start(library=f"aucamp {version('aucamp')}; mcap {version('mcap')}")
        self.note("aucamp.run", run)
        for name, text in attachments.items():
            self._writer.add_attachment(0, 0, name, "text/plain", text.encode())
        self.flush()

    def note(self, name: str, facts: Mapping[str, object]) -> None:
        """Add a metadata record."""
        self._writer.add_metadata(name, {key: str(value) for key, value in facts.items()})

    def add(self, entry: Entry) -> None:
        """Append one message; its channel and schema are registered as they come."""
        channel = self._channels.get(entry.channel)
        if channel is None:
            channel = self._channels[entry.channel] = self._register(entry)
        sequence = entry.sequence % 2**32  # the format's width
        self._writer.add_message(channel, entry.log_time_ns, entry.data, entry.publish_time_ns, sequence)
        self._last[entry.channel] = entry.sequence

    def flush(self) -> None:
        """Close the chunk and hand everything to the operating system: what SIGKILL cannot take away any more."""
        self._writer.flush()
        self._sound = self._file.tell()

    def sync(self) -> None:
        """Force everything flushed to the disk: what a power cut cannot take away any more."""
        os.fsync(self._file.fileno())

    @property
    def bytes(self) -> int:
        """Flushed so far."""
        return self._sound

    def finish(self, last_note: str, facts: Mapping[str, object]) -> None:
        """Write the summary, make it last, and give the file its final name."""
        self.note(last_note, {**facts, "last_sequence": json.dumps(self._last)})
        self._writer.finish()
        self._file.flush()
        self.sync()
        self._file.close()
        active(self.path).rename(self.path)
        _sync_directory(self.path.parent)

    def abandon(self) -> None:
        """Cut the file after its last flush and leave it `.active`; for a disk that takes no more."""
        with contextlib.suppress(OSError, ValueError):  # closing flushes, which that disk refuses again
            self._file.close()
        with contextlib.suppress(OSError):  # it went away, or it is finished
            os.truncate(active(self.path), self._sound)

    def _register(self, entry: Entry) -> int:
        schema = 0  # none
        if entry.schema is not None:
            schema = self._schemas.get(entry.schema.name, 0)
        if entry.schema is not None and schema == 0:
            schema = self._writer.register_schema(*entry.schema)
            self._schemas[entry.schema.name] = schema
        return int(self._writer.register_channel(entry.channel, entry.encoding, schema, dict(entry.metadata)))


def _sync_directory(path: Path) -> None:
    """Make a rename last: it is a change of the directory, not of the file."""
    directory = os.open(path, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)


class Tear(NamedTuple):
    """A stretch of the file that cannot be believed: an unfinished end, or a chunk that contradicts its checksum."""

    offset: int
    bytes: int


def records(path: Path) -> Iterator[McapRecord | Tear]:
    """Everything up to the summary's end in the order of the file, chunks opened; what is broken comes as a Tear.

    After a broken chunk the walk goes on, since its length still says where the next record begins. A record that is
    cut or has no sane length ends it. Raises ConfigError if the file cannot be opened or is no MCAP file.
    """
    try:
        file = path.open("rb")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give the path of a recording") from None
    with file:
        if not b"\x89MCAP".startswith(file.read(5)):  # less than that: its writer was killed at once
            raise ConfigError(f"{path}: is no recording; give a file that ends in .mcap or .mcap.active")
        size = file.seek(0, os.SEEK_END)
        file.seek(0)
        stream = _WholeReads(file)
        reader: Any = StreamReader(stream, emit_chunks=True, record_size_limit=RECORD_BYTES)  # type: ignore[arg-type]
        walk = iter(reader.records)
        while True:
            sound = stream.taken
            try:
                record = next(walk, None)
            except (McapError, ValueError, struct.error):
                yield Tear(sound, size - sound)
                return
            if record is None:  # after the footer
                return
            if isinstance(record, Chunk):
                try:
                    inside = breakup_chunk(record, validate_crc=True)
                except (McapError, ValueError, struct.error, zstandard.ZstdError, MemoryError):
                    yield Tear(sound, stream.taken - sound)
                else:
                    yield from inside
            else:
                yield record


class Summary(NamedTuple):
    """What stands at the end of a finished file."""

    notes: dict[str, dict[str, str]]  # metadata by name
    attachments: dict[str, str]
    messages: dict[str, int]  # by channel


def summary(path: Path) -> Summary | None:
    """What a finished file says of itself, without a walk through all of it; None if it has no sound end.

    Raises ConfigError if the file cannot be opened.
    """
    try:
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_size < SHORTEST:
                return None
            reader = SeekingReader(file, record_size_limit=RECORD_BYTES)
            about = reader.get_summary()
            if about is None or about.statistics is None:
                return None
            counts = about.statistics.channel_message_counts
            return Summary(
                notes={note.name: note.metadata for note in reader.iter_metadata()},
                attachments={each.name: each.data.decode() for each in reader.iter_attachments()},
                messages={channel.topic: counts.get(id_, 0) for id_, channel in about.channels.items()},
            )
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give the path of a recording") from None
    except (McapError, ValueError, struct.error, IndexError):
        return None


class _WholeReads:
    """A file from which a read gives all the bytes asked for or none: mcap takes a short read for a whole one."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.taken = 0

    def read(self, size: int) -> bytes:
        data = self._file.read(size)
        if len(data) != size:
            return b""
        self.taken += size
        return data
