"""A recording on the page: laid out by time, a cursor over it, and its outcome as the report says it. A recording takes
no orders.
"""

from __future__ import annotations

import asyncio
import tempfile
from bisect import bisect_right
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from itertools import chain
from pathlib import Path
from threading import Event, Thread
from types import TracebackType
from typing import Any, NamedTuple, Self

import msgspec

from agent.clock import machine
from agent.core.codec import Refusal
from agent.core.config import ConfigError
from agent.core.topics import Topic
from agent.ground.page.rows import CAME, KEPT, LINES, SELDOM_NS, Board, Rows, text
from replay.files.channels import network_topic
from replay.files.info import suspecting
from replay.files.log import read
from replay.report.timeline import open_fleet_file, open_run, surveyed

# --- a recording laid out ---
# A recording of a fleet, laid out so that any moment of it can be shown: rows by time, their payloads on the disk.

LEAST_NS = 90_000_000  # between two rows of one key that are kept: the page draws ten a second


class Row(NamedTuple):
    key: str
    topic: Topic
    chunks: dict[str, str]
    offset: int  # of the payload in the spool
    size: int
    at_ns: int  # when it was recorded


class Reel:
    """Context manager: its spool goes with it."""

    def __init__(self, path: Path) -> None:
        """`path`: a recording of a fleet, or the folder of a run with one in it. Raises ConfigError for others."""
        opened = open_fleet_file(path)
        self.file, self.fleet = opened.path, opened.fleet
        self.times_ns: list[int] = []
        self._rows: list[Row] = []
        self._of: dict[str, tuple[list[int], list[int]]] = {}  # key: its times, and which rows they are
        self._lines: list[int] = []  # which rows are lines
        self._spool = tempfile.TemporaryFile(prefix="aucamp-page-")  # noqa: SIM115 - closed by __exit__
        rows, topics = Rows(self.fleet), {}
        end = 0
        for record in chain.from_iterable(map(read, opened.paths)):
            if record.channel not in topics:
                topics[record.channel] = network_topic(record.channel)
            if (row := topics[record.channel]) is None or (key := rows.key(*row, record.data)) is None:
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
            self._rows.append(Row(key, *row, end, len(record.data), at_ns))
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


# --- the cursor ---

PERIOD_S = 0.05  # of the wall, between two steps of the cursor
CLOCK_S = 0.25  # of the wall, between two notes of where it is
SLOWEST, FASTEST = 0.1, 20.0
TRACK_NS = 30_000_000_000  # of what came before a moment that was sought, shown as tracks
TRACK_STEP_NS = 500_000_000
TRACKED = ("state", "near")


class Play(msgspec.Struct, frozen=True, kw_only=True):
    """What a page asks for; what is left out stays as it is."""

    paused: bool | None = None
    speed: float | None = None
    at_ms: float | None = None


class Replayed:
    """Moves the cursor, and takes what it passes to the board."""

    def __init__(self, reel: Reel, board: Board) -> None:
        self._reel, self._board, self._rows = reel, board, Rows(reel.fleet)
        self._first_ns, self._last_ns = reel.times_ns[0], reel.times_ns[-1]
        self._at_ns, self._speed, self._paused = self._first_ns, 1.0, False
        self._said_s = 0.0

    async def run(self, stop: Event) -> None:
        """Until `stop` is set."""
        self.seek(self._first_ns)
        before_s = machine.monotonic_s()
        while not stop.is_set():
            await asyncio.sleep(PERIOD_S)
            now_s = machine.monotonic_s()
            if self._board.watched and not self._paused:  # where nobody looks it stands
                self._advance(round((now_s - before_s) * self._speed * 1e9))
            before_s = now_s
            if now_s - self._said_s >= CLOCK_S:
                self._say_time()

    async def heard(self, message: dict[str, Any]) -> None:
        """What a page says. What none of ours would say is passed over."""
        try:
            play = msgspec.convert(message.get("play"), Play)
        except msgspec.ValidationError:
            return
        if play.speed is not None:
            self._speed = min(max(play.speed, SLOWEST), FASTEST)
        if play.at_ms is not None:
            self.seek(round(min(max(play.at_ms * 1e6, self._first_ns), self._last_ns)))
        if play.paused is not None:
            self._paused = play.paused
            if not play.paused and self._at_ns >= self._last_ns:  # from its end it starts again
                self.seek(self._first_ns)
        self._say_time()

    def seek(self, at_ns: int) -> None:
        """Show the newest of each key by then, the lines before it, and the tracks that lead there."""
        self._at_ns = at_ns
        self._board.start_over()
        self._say_time()  # before the rows, whose age it tells
        for row in self._reel.lines(at_ns, KEPT):
            self._take(row)
        self._show_tracks(at_ns)
        for row in self._reel.newest(at_ns):
            self._take(row)

    def _advance(self, by_ns: int) -> None:
        until_ns = min(self._at_ns + by_ns, self._last_ns)
        for _, row in self._reel.between(self._at_ns, until_ns):
            self._take(row)
        self._at_ns = until_ns
        if until_ns == self._last_ns and not self._paused:
            self._paused = True
            self._say_time()

    def _take(self, row: Row) -> None:
        if row.topic.message not in LINES:
            self._board.show(row.key, partial(self._message, row))
            return
        try:
            self._board.say(self._message(row))
        except Refusal:
            self._board.refused += 1

    def _message(self, row: Row) -> Any:
        return self._rows.message(row.topic, row.chunks, self._reel.payload(row), row.at_ns)

    def _show_tracks(self, at_ns: int) -> None:
        """Where robots and targets were before a moment that was sought, for the page to draw behind them."""
        shown: dict[str, int] = {}
        past: list[msgspec.Raw] = []
        for row_ns, row in self._reel.between(at_ns - TRACK_NS, at_ns):
            if row.key.partition("/")[0] not in TRACKED or row_ns - shown.get(row.key, 0) < TRACK_STEP_NS:
                continue
            shown[row.key] = row_ns
            with suppress(Refusal):
                past.append(msgspec.Raw(self._message(row).encode()))
        self._board.show("past", lambda: text({"k": "past", "rows": past}))

    def _say_time(self) -> None:
        self._said_s = machine.monotonic_s()
        note = {
            "k": "clock",
            "now_ms": self._at_ns * 1e-6,
            "rate": 0.0 if self._paused else self._speed,
            "refused": self._board.refused,
            "full": self._board.full,
            "first_ms": self._first_ns * 1e-6,
            "last_ms": self._last_ns * 1e-6,
            "speed": self._speed,
        }
        self._board.show("clock", lambda: text(note))


# --- outcome of a recorded run ---
# What came of a recorded run, as its report says it: found beside the page, for a long recording takes a while.


def show_what_came(path: Path, board: Board, loop: asyncio.AbstractEventLoop) -> None:
    """Show it on the board when it is found. A page that ends before does not wait for it."""

    def find() -> None:
        message = came_of(path)
        if not loop.is_closed():
            loop.call_soon_threadsafe(board.show, CAME, lambda: message)

    Thread(target=find, name="what came of it", daemon=True).start()


def came_of(path: Path) -> str:
    """The page's message: the sentence, the pictures and the table that the report of `path` leads with."""
    from replay.report.lead import lead  # with what draws and counts: only a recording needs it

    try:
        with suspecting(path):
            run = open_run(path)
            found = lead(run, surveyed(run))
    except ConfigError as error:
        return text({"k": CAME, "said": [["bad", f"What came of it cannot be told: {error}"]], "looks": [], "ends": []})
    looks = [(look.caption, str(look.svg)) for look in found.looks]
    return text({"k": CAME, "said": found.said, "looks": looks, "ends": found.ends.rows})
