"""Recording a fleet from the page's own process: on and off, into new files."""

from __future__ import annotations

import logging
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from threading import Event, Thread
from typing import Any

from agent.core.config import ConfigError
from agent.process.run_folder import free_name

logger = logging.getLogger(__name__)

Record = Callable[[Path, Event], object]  # into a file, until the event is set; raises ConfigError


class Recording:
    """At most one at a time. What goes wrong in it is told by `note`, and ends nothing else."""

    def __init__(self, record: Record, folder: Path, fleet: str) -> None:
        self._record, self._folder, self._fleet = record, folder, fleet
        self._stop, self._thread = Event(), Thread()
        self._file: Path | None = None
        self._trouble = ""

    def note(self) -> dict[str, Any]:
        """What the page shows of it."""
        return {"on": self._thread.is_alive(), "file": str(self._file or ""), "trouble": self._trouble}

    def start(self) -> None:
        if self._thread.is_alive():
            return
        stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
        self._file, self._trouble = free_name(self._folder / f"{self._fleet}_{stamp}.mcap"), ""
        self._stop = Event()
        self._thread = Thread(target=self._run, args=(self._file, self._stop), name="recording")
        self._thread.start()

    def stop(self) -> None:
        """Ask it to end; `note` says when it has."""
        self._stop.set()

    def close(self) -> None:
        """End it, and wait until its file is whole."""
        self.stop()
        if self._thread.ident is not None:
            self._thread.join()

    def _run(self, file: Path, stop: Event) -> None:
        try:
            self._record(file, stop)
            if not file.exists():
                self._trouble = "nobody was heard, so nothing was kept"
        except (ConfigError, OSError) as error:
            self._trouble = str(error)
            logger.warning("the recording ended: %s", error)
