"""The recording: an MCAP file, its writer and its reader side by side. The only file that imports mcap.

NAME.mcap.active is being written, or its writer was killed; NAME.mcap has been finished. Metadata `aucamp.run` comes
first, `aucamp.end` last; without the latter the end was not clean. The order in the file is the order of the writes.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import struct
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, NamedTuple, Self

import msgpack
import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, Footer, McapRecord, Message, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, Writer

from agent.config import ConfigError
from replay.backlog import Backlog, Drop, Entry
from replay.environment import version

logger = logging.getLogger(__name__)

CHUNK_BYTES = 256 * 1024  # the default, 1 MiB, is minutes of telemetry: all lost when the process is killed
WRITE_S = 0.5  # the thread writes and flushes this often; what SIGKILL can take away
SYNC_S = 5.0  # and forces it to the disk this often; what a power cut can take away
CLOSE_S = 10.0  # a disk that takes longer to finish a file is given up
BACKLOG_MESSAGES = 4096
BACKLOG_BYTES = 16 * 1024 * 1024
RECORD_BYTES = 64 * 1024 * 1024  # a longer record is a corrupt length
DROPS = "/raw/drops"


class Record(NamedTuple):
    channel: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


class LogWriter:
    """Writes one file from a thread of its own; the caller appends to a bounded backlog and never waits for a disk.

    A full backlog loses its oldest messages, which are counted and noted on the channel /raw/drops. Whatever goes wrong
    in the thread ends the recording and stands in `failed`; the caller goes on. Context manager.
    """

    def __init__(self, path: Path, run: Mapping[str, object], attachments: Mapping[str, str] | None = None) -> None:
        """`run` becomes the metadata `aucamp.run`; `attachments` are texts by file name."""
        self.path = path
        self.failed: str | None = None
        self._active = _active(path)
        self._run, self._attachments = run, attachments or {}
        self._backlog = Backlog(BACKLOG_MESSAGES, BACKLOG_BYTES)
        self._wake = threading.Event()
        self._cause: str | None = None  # why the file ends; None: it does not yet
        self._thread = threading.Thread(target=self._work, name=f"log {path.name}", daemon=True)

    def __enter__(self) -> Self:
        """Create the file. Raises ConfigError if it cannot be, or if there is one already."""
        for taken in (self.path, self._active):
            if taken.exists():
                raise ConfigError(f"{taken}: exists already; give another name or move it away")
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file: IO[bytes] = self._active.open("xb")
        except OSError as error:
            raise ConfigError(f"{self._active}: cannot be written: {error.strerror}; give another place") from None
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close("clean" if kind is None else f"exception:{kind.__name__}")

    def write(
        self,
        channel: str,
        log_time_ns: int,
        publish_time_ns: int,
        sequence: int,
        data: bytes,
        encoding: str = "msgpack",
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        """Queue one message. `encoding` and `metadata` are the channel's and count at its first message only."""
        if self.failed:
            return
        entry = Entry(channel, log_time_ns, publish_time_ns, sequence, data, encoding, metadata or {})
        if self._backlog.put(entry):
            self._wake.set()

    def close(self, cause: str = "clean") -> None:
        """Write what is queued, finish the file under its final name and end the thread. A second call does nothing."""
        if self._cause is None:
            self._cause = cause
            self._wake.set()
            self._thread.join(CLOSE_S)
            if self._thread.is_alive():
                self.failed = f"the disk did not take the file within {CLOSE_S:.0f} s"

    # --- the thread -------------------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            with self._file:
                self._write_file()
            self._active.rename(self.path)
            _sync_directory(self.path.parent)
        except Exception as error:  # noqa: BLE001 - whatever it is, the robot goes on without its recording
            self.failed = f"{type(error).__name__}: {error}"
            logger.error("%s: recording stopped: %s", self._active, self.failed)

    def _write_file(self) -> None:
        writer: Any = Writer(self._file, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        writer.start(library=f"aucamp {version('aucamp')}; mcap {version('mcap')}")
        writer.add_metadata("aucamp.run", {name: str(value) for name, value in self._run.items()})
        for name, text in self._attachments.items():
            writer.add_attachment(0, 0, name, "text/plain", text.encode())
        writer.flush()
        tally = _Tally(writer)
        synced_s = time.monotonic()
        while True:
            last = self._cause is not None  # looked at before the queue: what was queued before close is written
            tally.write(*self._backlog.take())
            writer.flush()
            if last:
                break
            if time.monotonic() - synced_s > SYNC_S:
                os.fsync(self._file.fileno())
                synced_s = time.monotonic()
            self._wake.wait(WRITE_S)
            self._wake.clear()
        writer.add_metadata("aucamp.end", {"cause": self._cause or "", **tally.summary()})
        writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())


class _Tally:
    """Gives messages to the MCAP writer, registering channels as they come, and counts what the queue lost."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._ids: dict[str, int] = {}
        self._last: dict[str, int] = {}
        self._dropped: Counter[str] = Counter()

    def write(self, entries: Iterable[Entry], drops: Mapping[str, Drop]) -> None:
        for channel, drop in drops.items():  # before the entries, which are younger
            self._dropped[channel] += drop.messages
            note = {"channel": channel, "messages": drop.messages, "first": drop.first, "last": drop.last}
            data = bytes(msgpack.packb(note))
            self._add(Entry(DROPS, drop.last_ns, drop.last_ns, drop.last, data, "msgpack", {}))
        for entry in entries:
            self._add(entry)

    def summary(self) -> dict[str, str]:
        return {"last_sequence": json.dumps(self._last), "dropped": json.dumps(self._dropped)}

    def _add(self, entry: Entry) -> None:
        id_ = self._ids.get(entry.channel)
        if id_ is None:
            id_ = self._writer.register_channel(entry.channel, entry.encoding, 0, dict(entry.metadata))
            self._ids[entry.channel] = id_
        sequence = entry.sequence % 2**32  # the format's width
        self._writer.add_message(id_, entry.log_time_ns, entry.data, entry.publish_time_ns, sequence)
        self._last[entry.channel] = entry.sequence


def unused(path: Path) -> Path:
    """`path`, or NAME.2.mcap and so on if it is taken: a robot that starts again keeps what it recorded before."""
    name, number = path.name.removesuffix(".mcap"), 2
    while path.exists() or _active(path).exists():
        path = path.with_name(f"{name}.{number}.mcap")
        number += 1
    return path


class ChannelInfo(NamedTuple):
    encoding: str
    metadata: dict[str, str]
    messages: int
    bytes: int  # before compression
    first_ns: int
    last_ns: int


class Info(NamedTuple):
    complete: bool  # finished by its writer; False: everything up to the tear
    run: dict[str, str]
    end: dict[str, str]  # empty when the writer was killed
    channels: dict[str, ChannelInfo]
    attachments: dict[str, str]


def read(path: Path) -> Iterator[Record]:
    """Messages in the order of the file, which for a black box is the order of its steps; unfinished: up to the tear.

    Raises ConfigError if the file cannot be opened or is no MCAP file.
    """
    channels: dict[int, str] = {}
    for record in _records(path):
        if isinstance(record, Channel):
            channels[record.id] = record.topic
        elif isinstance(record, Message):
            channel = channels[record.channel_id]
            yield Record(channel, record.log_time, record.publish_time, record.sequence, record.data)


def info(path: Path) -> Info:
    """What is in the file, from a walk through all of it. Raises as `read` does."""
    run: dict[str, str] = {}
    end: dict[str, str] = {}
    attachments: dict[str, str] = {}
    topics: dict[int, Channel] = {}
    channels: dict[str, ChannelInfo] = {}
    footer = False
    for record in _records(path):
        match record:
            case Metadata(name="aucamp.run"):
                run = record.metadata
            case Metadata(name="aucamp.end"):
                end = record.metadata
            case Attachment():
                attachments[record.name] = record.data.decode()
            case Channel():
                topics[record.id] = record
            case Message():
                about = topics[record.channel_id]
                new = ChannelInfo(about.message_encoding, about.metadata, 0, 0, record.log_time, record.log_time)
                old = channels.get(about.topic, new)
                channels[about.topic] = old._replace(
                    messages=old.messages + 1,
                    bytes=old.bytes + len(record.data),
                    first_ns=min(old.first_ns, record.log_time),
                    last_ns=max(old.last_ns, record.log_time),
                )
            case Footer():
                footer = True
    return Info(footer and bool(end), run, end, channels, attachments)


class _WholeReads:
    """A file from which a read gives all the bytes asked for or none: mcap takes a short read for a whole one."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        data = self._file.read(size)
        return data if len(data) == size else b""


def _records(path: Path) -> Iterator[McapRecord]:
    try:
        file = path.open("rb")
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}; give the path of a recording") from None
    with file:
        if not b"\x89MCAP".startswith(file.read(5)):  # less than that: its writer was killed at once
            raise ConfigError(f"{path}: is no recording; give a file that ends in .mcap or .mcap.active")
        file.seek(0)
        stream: Any = _WholeReads(file)
        # Whatever does not parse is the tear: what was written later cannot be found any more.
        with contextlib.suppress(McapError, ValueError, struct.error, zstandard.ZstdError):
            yield from StreamReader(stream, validate_crcs=True, record_size_limit=RECORD_BYTES).records


def _active(path: Path) -> Path:
    return path.with_name(path.name + ".active")


def _sync_directory(path: Path) -> None:
    """Make a rename last: it is a change of the directory, not of the file."""
    directory = os.open(path, os.O_RDONLY)
    try:
        os.fsync(directory)
    finally:
        os.close(directory)
