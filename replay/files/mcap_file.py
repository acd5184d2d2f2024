"""One MCAP file under construction. Reading is mcap_walk.py's; nothing else imports mcap.

NAME.mcap.active is being written, or its writer was killed; NAME.mcap has been finished and has a summary. Metadata
`aucamp.run` comes first, `aucamp.end` last; without the latter the end was not clean.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from mcap.writer import CompressionType, Writer

from agent.core.config import ConfigError
from replay.files.backlog import Entry
from replay.files.digests import ATTACHED, BEFORE, HashedFile, of_attachments, stamped
from replay.files.environment import version
from replay.files.file_lock import hold, is_held
from replay.files.names import active

CHUNK_BYTES = 256 * 1024  # the format's default, 1 MiB, is minutes of telemetry: all lost when the process is killed


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
        self._hashed = HashedFile(self._file)
        out: Any = self._hashed  # as much of a file as a writer needs
        self._writer: Any = Writer(out, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True)
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._last: dict[str, int] = {}  # newest sequence number, by channel
        self._sound = 0  # bytes of whole records

    def start(self, run: Mapping[str, object], attachments: Mapping[str, str]) -> None:
        """Write and flush what stands at the head of the file. `attachments` are texts by file name.

        Their digests become entries of the header, in place of those that `run` has.
        """
        self._writer.start(library=f"aucamp {version('aucamp')}; mcap {version('mcap')}")
        facts = {name: value for name, value in run.items() if not name.startswith(ATTACHED)}
        self.note("aucamp.run", {**facts, **of_attachments(attachments)})
        for name, text in attachments.items():
            self._writer.add_attachment(0, 0, name, "text/plain", text.encode())
        self.flush()

    def note(self, name: str, facts: Mapping[str, object]) -> None:
        """Add a metadata record, with a digest of itself."""
        self._writer.add_metadata(name, stamped(name, facts))

    def has_room(self, channel: str, most: int) -> bool:
        """Whether a message on this channel leaves the file with no more than so many channels."""
        return channel in self._channels or len(self._channels) < most

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
        self._writer.flush()  # messages that still wait stand before the last note, and are in its digest
        self.note(last_note, {**facts, "last_sequence": json.dumps(self._last), BEFORE: self._hashed.before})
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
