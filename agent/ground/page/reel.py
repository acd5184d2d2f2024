"""A recording of a fleet, laid out so that any moment of it can be shown: rows by time, their payloads on the disk."""

from __future__ import annotations

import tempfile
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from agent.core.config import ConfigError, Fleet
from agent.core.topics import Topic
from agent.ground.page.rows import LINES, SELDOM_NS, Rows
from replay.check.black_box import recordings
from replay.files.channels import network_topic
from replay.files.log import read
from replay.report.fleet_timeline import open_fleet_file

LEAST_NS = 90_000_000  # between two rows of one key that are kept: the page draws ten a second


class Row(NamedTuple):
    key: str
    topic: Topic
    chunks: dict[str, str]
    offset: int  # of the payload in the spool
    size: int


class Reel:
    """Context manager: its spool goes with it."""

    def __init__(self, path: Path) -> None:
        """`path`: a recording of a fleet, or the folder of a run with one in it. Raises ConfigError for others."""
        self.file = fleet_file(path)
        self.fleet: Fleet = open_fleet_file(self.file).fleet
        self.times_ns: list[int] = []
        self._rows: list[Row] = []
        self._of: dict[str, tuple[list[int], list[int]]] = {}  # key: its times, and which rows they are
        self._lines: list[int] = []  # which rows are lines
        self._spool = tempfile.TemporaryFile(prefix="aucamp-page-")  # noqa: SIM115 - closed by __exit__
        rows, topics = Rows(self.fleet), {}
        end = 0
        for record in read(self.file):
            if record.channel not in topics:
                topics[record.channel] = network_topic(record.channel)
            if (row := topics[record.channel]) is None or (key := rows.key(*row)) is None:
                continue
            is_line = row[0].message in LINES
            times, numbers = self._of.setdefault(key, ([], []))
            least_ns = SELDOM_NS.get(row[0].message, LEAST_NS)
            if times and not is_line and record.log_time_ns - times[-1] < least_ns:
                continue
            at_ns = max(record.log_time_ns, self.times_ns[-1] if self.times_ns else 0)
            times.append(at_ns)
            numbers.append(len(self._rows))
            if is_line:
                self._lines.append(len(self._rows))
            self.times_ns.append(at_ns)
            self._rows.append(Row(key, *row, end, len(record.data)))
            end += self._spool.write(record.data)
        if not self._rows:
            raise ConfigError(f"{self.file}: nobody of fleet '{self.fleet.fleet}' was heard in it")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        self._spool.close()

    def payload(self, row: Row) -> bytes:
        self._spool.seek(row.offset)
        return self._spool.read(row.size)

    def between(self, after_ns: int, until_ns: int) -> Iterator[tuple[int, Row]]:
        """What was recorded later than the one time and not later than the other, and when."""
        first, last = bisect_right(self.times_ns, after_ns), bisect_right(self.times_ns, until_ns)
        yield from zip(self.times_ns[first:last], self._rows[first:last], strict=True)

    def newest(self, at_ns: int) -> Iterator[Row]:
        """Of each key that is no line, what was recorded last by then."""
        for times, numbers in self._of.values():
            last = bisect_right(times, at_ns) - 1
            if last >= 0 and (row := self._rows[numbers[last]]).topic.message not in LINES:
                yield row

    def lines(self, at_ns: int, most: int) -> Iterator[Row]:
        """The last lines by then, in their order."""
        last = bisect_right(self._lines, at_ns, key=lambda number: self.times_ns[number])
        yield from (self._rows[number] for number in self._lines[max(0, last - most) : last])


def fleet_file(path: Path) -> Path:
    """The recording of the fleet that a path stands for. Raises ConfigError where there is none."""
    if not path.is_dir():
        return path
    found = recordings(path, "fleet")
    if not found:
        raise ConfigError(f"{path}: has no recording of a fleet in it; give the folder of a run, or what record wrote")
    return found[0]
