"""The recording: its writer, which never holds up the robot, and its reader side by side.

A long recording is a chain of files: r1.mcap, r1.part002.mcap, r1.part003.mcap. Each one starts with the metadata and
the attachments and can be viewed alone; replay needs the chain, since a step depends on all steps before it. The order
in the files is the order of the writes.
"""

from __future__ import annotations

import json
import logging
import shutil
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

import msgpack

from agent.clock import machine
from agent.core.codec import prepare
from agent.core.config import ConfigError
from replay.files.channels import DROPS, Backlog, Drop, Entry, entry_on
from replay.files.info import ChannelInfo, Info, info
from replay.files.mcap_file import ROTATED, Part, active, part, parts, unused
from replay.files.mcap_walk import Channel, Message, Tear, records

__all__ = ["ChannelInfo", "Info", "Limits", "LogWriter", "Record", "info", "parts", "read", "unused"]

logger = logging.getLogger(__name__)

WRITE_S = 0.3  # the thread writes and flushes this often; what SIGKILL can take away
SYNC_S = 5.0  # and forces it to the disk this often; what a power cut can take away
ROOM = 2.0  # times the floor have to be free before recording goes on
CLOSE_S = 10.0  # a disk that takes longer to finish a file is given up
STUCK_S = 10.0  # a disk that takes nothing for so long does not answer
DERIVED_CHANNELS = 20_000  # a third of what the format can number: the rest is for what was really there
BACKLOG_MESSAGES = 4096
BACKLOG_BYTES = 16 * 1024 * 1024

REASON = 200  # characters of one

Derive = Callable[[Entry], Iterable[Entry]]


class Limits(NamedTuple):
    """When the next part begins, and how much of the disk is left to others."""

    part_bytes: int = 512 * 10**6  # one part can be mailed or opened on a laptop
    part_s: float = 900.0
    floor_bytes: int = 10**9  # below this, or on a small disk below this share of it, recording ends:
    floor_share: float = 0.05  # a full disk harms more than a missing recording


class LogWriter:
    """Writes a recording from a thread of its own; the caller appends to a bounded backlog and never waits for a disk.

    A full backlog loses frames first, then its oldest messages; both are counted and noted on the channel DROPS.
    Whatever goes wrong in the thread ends the recording and stands in `failed`; the caller goes on. A disk without room
    stands there too, and the next part, or the first, begins once there is room. A file that is removed or moved away
    is begun anew. `at_end` are facts for the last note, which the caller may add to until the end. Context manager.
    """

    def __init__(
        self,
        path: Path,
        run: Mapping[str, object],
        attachments: Mapping[str, str] | None = None,
        limits: Limits = Limits(),  # noqa: B008 - a NamedTuple cannot change
        splits_at: str | None = None,
        derive: Derive | None = None,
        needed: bool = True,
    ) -> None:
        """`run` becomes the metadata `aucamp.run`; `attachments` are texts by file name. `needed`: the caller is not to
        begin without its file; else that it cannot be created stands in `failed`, as what goes wrong later.

        A new part begins with a message on the channel `splits_at`; None: with any. `derive` gives further messages to
        write behind each one; it runs on the thread, and where it raises, that message has none.
        """
        self.path = path
        self.at_end: dict[str, object] = {}
        self.failed: str | None = None  # why nothing is recorded any more, or for now
        self._lost: str | None = None  # what was recorded and is there no more
        self._attachments = attachments or {}
        self._run = run
        self._limits, self._splits_at, self._derive, self._needed = limits, splits_at, derive, needed
        self._backlog = Backlog(BACKLOG_MESSAGES, BACKLOG_BYTES)
        self._dropped: Counter[str] = Counter()
        self._not_derived: Counter[str] = Counter()  # messages without viewer channels, by what was wrong
        self._busy_since_s: float | None = None  # since when the disk has been at it; None: it waits
        self._wake = threading.Event()
        self._waits = False  # for room on the disk
        self._cause: str | None = None  # why the recording ends; None: it does not yet
        self._number = 1  # of the part
        self._thread = threading.Thread(target=self._work, name=f"log {path.name}", daemon=True)

    def __enter__(self) -> Self:
        """Create the file. Raises ConfigError if it is needed and cannot be, or if there is one already."""
        try:
            self._part = Part(self.path)
        except ConfigError as error:
            if self._needed:
                raise
            self.failed, self._cause = str(error), "never begun"
            logger.error("recording stopped: %s", self.failed)
            return self
        prepare()  # the thread reads messages, for viewers
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self.close("clean" if kind is None else f"exception:{kind.__name__}")

    def put(self, entry: Entry) -> None:
        """Queue one message; what it says of its channel counts at the channel's first message only."""
        if (not self.failed or self._waits) and self._backlog.put(entry):
            self._wake.set()

    def close(self, cause: str = "clean") -> None:
        """Write what is queued, finish the file under its final name and end the thread. A second call does nothing."""
        if self._cause is None:
            self._cause = cause
            self._wake.set()
            self._thread.join(CLOSE_S)
            if self._thread.is_alive():
                self.failed = f"the disk did not take the file within {CLOSE_S:.0f} s"

    @property
    def fault(self) -> str | None:
        """Why not all is recorded: the recording has ended, the disk does not answer, or what was recorded was taken
        away. None: all is well."""
        if self.failed is None and self.stuck_s > STUCK_S:
            return f"the disk has taken nothing for more than {STUCK_S:.0f} s"
        return self.failed or self._lost

    @property
    def stuck_s(self) -> float:
        """For how long the disk has been at what it was given last; 0: it is done."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else machine.monotonic_s() - since_s

    # --- the thread -------------------------------------------------------------------------------------------

    def _work(self) -> None:
        try:
            self._write_all()
        except Exception as error:  # noqa: BLE001 - whatever it is, the robot goes on without its recording
            self.failed = f"{type(error).__name__}: {error}"
            if isinstance(error, ConfigError):
                self.failed = str(error)
            elif isinstance(error, OSError) and error.strerror:
                self.failed = f"{error.strerror}; see to {self._folder}, and start again"
            logger.error("%s: recording stopped: %s", active(self._part.path), self.failed)
            self._part.abandon()
        finally:
            self._busy_since_s = None

    def _write_all(self) -> None:
        self._busy_since_s = machine.monotonic_s()
        if not self._begin_first():
            return None
        synced_s = machine.monotonic_s()
        while True:
            self._busy_since_s = machine.monotonic_s()
            last = self._cause is not None  # looked at before the queue: what was queued before close is written
            if self._part.is_gone():
                self._begin_again()
            if (full := self._floor_reached()) is not None:
                self._end_part("disk_floor")
                self._number += 1
                if not self._room_again(full):
                    return None
            self._write_waiting()
            self._part.flush()
            if last:
                return self._end_part(self._cause or "")
            if machine.monotonic_s() - synced_s > SYNC_S:
                self._part.sync()
                synced_s = machine.monotonic_s()
            self._busy_since_s = None
            machine.wait(self._wake, WRITE_S)
            self._wake.clear()

    def _room_again(self, full: str) -> bool:
        """Wait until there is room, and begin the part of that number; False: the recording was closed meanwhile."""
        self._waits, self.failed = True, full
        logger.error("%s: recording stopped: %s", self._part.path, full)
        self._busy_since_s = None
        while self._floor_reached(ROOM) is not None:
            if self._cause is not None:
                return False
            machine.wait(self._wake, WRITE_S)
            self._wake.clear()
        self._part = Part(part(self.path, self._number))
        self._begin_part()
        self._waits, self.failed = False, None
        logger.warning("%s: recording goes on", self._part.path)
        return True

    def _write_waiting(self) -> None:
        entries, drops = self._backlog.take()
        for channel, drop in drops.items():  # before the entries, which are younger
            self._dropped[channel] += drop.messages
            self._part.add(drop_note(channel, drop))
        due = self._part_is_full()
        for entry in entries:
            if due and self._splits_at in (None, entry.channel):
                due = False
                self._next_part()
            self._part.add(entry)
            for derived in self._derived(entry):
                if self._part.has_room(derived.channel, DERIVED_CHANNELS):
                    self._part.add(derived)
                else:
                    self._without("too many channels", entry)

    def _derived(self, entry: Entry) -> Iterable[Entry]:
        if self._derive is None:
            return ()
        try:
            return list(self._derive(entry))
        except Exception as error:  # noqa: BLE001 - what only viewers need must not end a black box
            self._without(f"{type(error).__name__}: {error}"[:REASON], entry)
            return ()

    def _without(self, why: str, entry: Entry) -> None:
        """Count a message that viewers do not get all of; the log has the first of each kind."""
        kind = why.partition(":")[0]
        self._not_derived[kind] += 1
        if self._not_derived[kind] == 1:
            logger.warning("%s: not all for viewers of a message on %s: %s", self._part.path, entry.channel, why)

    # --- parts ------------------------------------------------------------------------------------------------

    def _begin_first(self) -> bool:
        """The first part; a disk that is full to the last byte takes it when there is room. False: the recording was
        closed before that."""
        try:
            self._begin_part()
            return True
        except OSError:
            if (full := self._floor_reached()) is None:
                raise
        self._part.abandon()
        return self._room_again(full)

    def _begin_part(self) -> None:
        self._began_s = machine.monotonic_s()
        self._part.start({**self._run, "part": self._number}, self._attachments)
        self._note_clock("start")

    def _next_part(self) -> None:
        """The new part is opened before the old one is finished: there is no moment without a file."""
        self._number += 1
        new = Part(part(self.path, self._number))
        self._end_part(ROTATED)
        self._part = new
        self._begin_part()

    def _begin_again(self) -> None:
        file = active(self._part.path)
        self._lost = (
            f"{file} was removed or moved away; from then on it is recorded anew: leave the files until the end"
        )
        logger.error("%s", self._lost)
        self._part.abandon()
        self._part = Part(self._part.path)
        self._begin_part()

    def _end_part(self, cause: str) -> None:
        self._note_clock("end")
        facts = {"cause": cause, "dropped": json.dumps(self._dropped), **self.at_end}
        if self._not_derived:
            facts["not_derived"] = json.dumps(self._not_derived)
        self._part.finish("aucamp.end", facts)

    def _note_clock(self, when: str) -> None:
        """Both clocks at one moment: their difference over a run is how far the computer's clock was corrected."""
        self._part.note(f"aucamp.clock.{when}", {"unix_ns": machine.unix_ns(), "monotonic_ns": machine.monotonic_ns()})

    def _part_is_full(self) -> bool:
        age_s = machine.monotonic_s() - self._began_s
        return self._part.bytes >= self._limits.part_bytes or age_s >= self._limits.part_s

    @property
    def _folder(self) -> Path:
        return self.path.parent.absolute()

    def _floor_reached(self, times: float = 1.0) -> str | None:
        """Where less is free than so many times the floor, what to do about it."""
        total, _, free = shutil.disk_usage(self.path.parent)
        floor = min(self._limits.floor_bytes, round(self._limits.floor_share * total))
        if free >= times * floor:
            return None
        room = f"make room there, {ROOM * floor / 1e6:.0f} MB in all"
        return f"{free / 1e6:.0f} MB free in {self._folder}, the floor is {floor / 1e6:.0f} MB; {room}"


def drop_note(channel: str, drop: Drop) -> Entry:
    """What the file says about messages that are not in it."""
    note = {"channel": channel, **drop._asdict()}
    return entry_on(DROPS, drop.last_ns, drop.last_ns, drop.last, bytes(msgpack.packb(note)))


# --- the reader ---------------------------------------------------------------------------------------------------


class Record(NamedTuple):
    channel: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes


def read(path: Path) -> Iterator[Record]:
    """Messages in the order of the file and its later parts, which for a black box is the order of its steps.

    Ends at the first tear: what comes after it has lost its past. Raises ConfigError if a file cannot be opened or is
    no MCAP file.
    """
    for file in parts(path):
        channels: dict[int, str] = {}
        for record in records(file):
            if isinstance(record, Channel):
                channels[record.id] = record.topic
            elif isinstance(record, Message):
                channel = channels.get(record.channel_id)
                if channel is None:  # `records` ends with saying so
                    continue
                yield Record(channel, record.log_time, record.publish_time, record.sequence, record.data)
            elif isinstance(record, Tear):
                return
