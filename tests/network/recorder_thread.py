"""A recorder in a thread of the test's process, and what it has written so far."""

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import zenoh

from agent.clock.clock import SystemClock
from agent.core import topics
from agent.core.config import Fleet
from replay.files.log import Record, read
from replay.recorder import record
from tests.waiting import until

StartRecorder = Callable[..., "RecorderThread"]


class RecorderThread:
    """Records from its making until `stop` or `end`; `warnings` are the lines it has for a person."""

    def __init__(self, fleet: Fleet, out: Path, **options: Any) -> None:
        """`options` as `record` takes them."""
        self.warnings: list[str] = []
        self._active = out.with_name(f"{out.name}.active")
        self._stop = threading.Event()
        self._pool = ThreadPoolExecutor(1)
        self._counts = self._pool.submit(record, fleet, out, self._stop, SystemClock(), self.warnings.append, **options)

    def recorded(self, channels: str) -> list[Record]:
        """Messages on channels with this in their name, as far as they have been written."""
        found = read(self._active) if self._active.exists() else ()
        return [item for item in found if channels in item.channel]

    def counts(self, timeout_s: float = 60.0) -> dict[str, int]:
        """What `record` returns or raises, once it ends by itself."""
        return self._counts.result(timeout_s)

    def end(self) -> dict[str, int]:
        """What `record` returns or raises."""
        self.stop()
        return self.counts()

    def stop(self) -> None:
        self._stop.set()
        self._pool.shutdown()


def heard_everywhere(session: zenoh.Session, fleet: str) -> None:
    """Wait until a recorder hears every key of a fleet in this session; it subscribes to keys of nobody last."""
    publisher = session.declare_publisher(topics.ALL.format(fleet=fleet).replace("**", "of/nobody"))
    until(lambda: publisher.matching_status.matching)
    publisher.undeclare()
