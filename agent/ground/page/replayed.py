"""A recording on the page: a cursor over the time at which its rows were recorded. Nobody can be ordered about."""

from __future__ import annotations

import asyncio
from contextlib import suppress
from functools import partial
from threading import Event
from typing import Any

import msgspec

from agent.clock import machine
from agent.core.codec import Refusal
from agent.ground.page.board import KEPT, Board
from agent.ground.page.reel import Reel, Row
from agent.ground.page.rows import LINES, Rows, text

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
            if not self._paused:
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
        return self._rows.message(row.topic, row.chunks, self._reel.payload(row))

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
            "first_ms": self._first_ns * 1e-6,
            "last_ms": self._last_ns * 1e-6,
            "speed": self._speed,
        }
        self._board.show("clock", lambda: text(note))
