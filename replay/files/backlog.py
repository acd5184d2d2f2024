"""What waits for the disk: bounded in messages and in bytes; frames give way before state; every loss is counted."""

from __future__ import annotations

import heapq
import threading
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple


class Schema(NamedTuple):
    """How a viewer decodes a channel: `data` is a FileDescriptorSet for the encoding "protobuf"."""

    name: str
    encoding: str
    data: bytes


class Entry(NamedTuple):
    """One message on its way into a file. `encoding`, `metadata` and `schema` are the channel's."""

    channel: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes
    encoding: str
    metadata: Mapping[str, str]
    schema: Schema | None = None
    expendable: bool = False  # can be lost without harm to replay: frames


class Drop(NamedTuple):
    """Messages of one channel that were thrown away between two takes; `first` and `last` are sequence numbers."""

    messages: int
    bytes: int
    first: int
    last: int
    last_ns: int


class Backlog:
    """A queue between threads that must not wait and the thread that writes.

    Full, it loses its oldest expendable entry; when it has none left, its oldest.
    """

    def __init__(self, max_messages: int, max_bytes: int) -> None:
        self._max_messages, self._max_bytes = max_messages, max_bytes
        self._vital: deque[tuple[int, Entry]] = deque()  # with the number of its arrival
        self._expendable: deque[tuple[int, Entry]] = deque()
        self._arrivals = 0
        self._bytes = 0
        self._drops: dict[str, Drop] = {}
        self._lock = threading.Lock()  # guards all of the above

    def put(self, entry: Entry) -> bool:
        """Append; True once it is half full: time to come and take."""
        with self._lock:
            (self._expendable if entry.expendable else self._vital).append((self._arrivals, entry))
            self._arrivals += 1
            self._bytes += len(entry.data)
            while len(self) > self._max_messages or self._bytes > self._max_bytes:
                self._lose((self._expendable or self._vital).popleft()[1])
            return 2 * len(self) > self._max_messages or 2 * self._bytes > self._max_bytes

    def take(self) -> tuple[list[Entry], dict[str, Drop]]:
        """All that waits, in order of arrival, and what was lost since the last take, by channel."""
        with self._lock:
            vital, self._vital = self._vital, deque()
            expendable, self._expendable = self._expendable, deque()
            drops, self._drops = self._drops, {}
            self._bytes = 0
        return [entry for _, entry in heapq.merge(vital, expendable)], drops

    def __len__(self) -> int:
        return len(self._vital) + len(self._expendable)

    def _lose(self, entry: Entry) -> None:
        self._bytes -= len(entry.data)
        drop = self._drops.get(entry.channel, Drop(0, 0, entry.sequence, 0, 0))
        self._drops[entry.channel] = Drop(
            drop.messages + 1, drop.bytes + len(entry.data), drop.first, entry.sequence, entry.log_time_ns
        )
