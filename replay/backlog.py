"""What waits for the disk: bounded in messages and in bytes, and what does not fit is counted."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Mapping
from typing import NamedTuple


class Entry(NamedTuple):
    channel: str
    log_time_ns: int
    publish_time_ns: int
    sequence: int
    data: bytes
    encoding: str
    metadata: Mapping[str, str]


class Drop(NamedTuple):
    """Messages of one channel that were thrown away between two takes; `first` and `last` are sequence numbers."""

    messages: int
    first: int
    last: int
    last_ns: int


class Backlog:
    """A queue between the thread that steps and the thread that writes. Full, it loses its oldest entries."""

    def __init__(self, max_messages: int, max_bytes: int) -> None:
        self._max_messages, self._max_bytes = max_messages, max_bytes
        self._entries: deque[Entry] = deque()
        self._bytes = 0
        self._drops: dict[str, Drop] = {}
        self._lock = threading.Lock()  # guards the three above

    def put(self, entry: Entry) -> bool:
        """Append; True once it is half full: time to come and take."""
        with self._lock:
            self._entries.append(entry)
            self._bytes += len(entry.data)
            while len(self._entries) > self._max_messages or self._bytes > self._max_bytes:
                oldest = self._entries.popleft()
                self._bytes -= len(oldest.data)
                drop = self._drops.get(oldest.channel, Drop(0, oldest.sequence, 0, 0))
                self._drops[oldest.channel] = Drop(drop.messages + 1, drop.first, oldest.sequence, oldest.log_time_ns)
            return 2 * len(self._entries) > self._max_messages or 2 * self._bytes > self._max_bytes

    def take(self) -> tuple[deque[Entry], dict[str, Drop]]:
        """All that waits, oldest first, and what was lost since the last take, by channel."""
        with self._lock:
            entries, self._entries = self._entries, deque()
            drops, self._drops = self._drops, {}
            self._bytes = 0
        return entries, drops
