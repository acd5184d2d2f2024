"""A running fleet on the page: what its robots show, orders to them, and a recording of it from this process."""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from threading import Event, Thread
from typing import Any, NamedTuple

import msgspec

from agent.clock import machine
from agent.clock.clock import Clock
from agent.core.codec import Refusal
from agent.core.config import ConfigError, Fleet
from agent.core.messages import State
from agent.core.topics import ANSWER, CLAIM, IMAGE, KEYFRAME, LINK, LOG, NEAR, STATE
from agent.core.verbs import CLOCK, URGENT
from agent.ground.console import OrderConsole
from agent.ground.page.rows import LINES, SELDOM_NS, Board, Rows, text
from agent.process.command import free_name
from agent.process.transport import Observer, Received

# --- recording from the page ---
# Recording a fleet from the page's own process: on and off, into new files.

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


# --- a running fleet ---

SHOWN = (STATE, LINK, NEAR, CLAIM, KEYFRAME, IMAGE, LOG, ANSWER)
PERIOD_S = 0.1  # of the wall, between two looks at what has arrived: states come no more often
CLOCK_S = 0.5  # of the wall, between two notes of what time it is in the fleet
UNDER_WAY = 16  # orders that wait for answers at a time; and as many that are urgent


class Wish(msgspec.Struct, frozen=True, kw_only=True):
    """An order as a page asks for it."""

    robots: list[str]
    verb: str
    args: dict[str, bool | int | float | str] = {}
    seen: dict[str, tuple[str, str]] = {}  # of each robot incarnation and sent_ns of the State looked at, as they came


class Reply(NamedTuple):
    """What became of an order at one robot."""

    robot: str
    ok: bool | None  # whether it is done, or under way; None: it did not answer
    why: str
    id: str  # of the order, as answers on the network say; empty: it did not answer


Seen = dict[str, tuple[int, int]]
# Gives what came of it as it comes, and waits in between; raises Refusal for what cannot be ordered.
Give = Callable[[list[str], str, Mapping[str, Any], Seen], Iterator[Reply]]


class Live:
    """Takes what a fleet shows to the board, and what pages ask for to where it goes."""

    def __init__(
        self, fleet: Fleet, board: Board, clock: Clock, give: Give | None = None, recording: Recording | None = None
    ) -> None:
        """`give` gives an order and waits for the replies; None: nobody may. `recording`; None: nothing records."""
        self._fleet, self._board, self._clock = fleet, board, clock
        self._give, self._recording = give, recording
        self._rows, self._numbers = Rows(fleet), itertools.count(1)
        self._shown_ns: dict[str, int] = {}  # when, of what is not shown each time
        # What is urgent has places and threads of its own: however many orders wait, a stop goes out.
        self._under_way: dict[bool, set[asyncio.Task[None]]] = {False: set(), True: set()}
        self._threads = {urgent: ThreadPoolExecutor(UNDER_WAY, "orders") for urgent in self._under_way}

    async def run(self, observer: Observer, stop: Event) -> None:
        """Until `stop` is set."""
        said_s = machine.monotonic_s() - CLOCK_S
        try:
            while not stop.is_set():
                for received in observer.drain():
                    self._take(received)
                if (now_s := machine.monotonic_s()) - said_s >= CLOCK_S:
                    said_s = now_s
                    self._say_time()
                await asyncio.sleep(PERIOD_S)
        finally:
            for threads in self._threads.values():
                threads.shutdown(cancel_futures=True)  # they use the console, which goes next

    def _take(self, received: Received) -> None:
        topic, chunks, payload, arrived_ns = received
        key = self._rows.key(topic, chunks, payload)
        if key is None:
            return
        seldom_ns, shown_ns = SELDOM_NS.get(topic.message), self._shown_ns.get(key)
        if seldom_ns is not None and shown_ns is not None and arrived_ns - shown_ns < seldom_ns:
            return
        if topic.message not in LINES:
            if self._board.show(key, partial(self._rows.message, *received)) and seldom_ns is not None:
                self._shown_ns[key] = arrived_ns
            return
        try:
            self._board.say(self._rows.message(*received))
        except Refusal:
            self._board.refused += 1

    def _say_time(self) -> None:
        note = {
            "k": "clock",
            "now_ms": self._now_ms(),
            "rate": self._clock.rate(),
            "refused": self._board.refused,
            "full": self._board.full,
            "recording": self._recording.note() if self._recording else None,
        }
        self._board.show("clock", lambda: text(note))

    def _now_ms(self) -> float:
        return self._clock.now_ns() * 1e-6

    async def heard(self, message: dict[str, Any]) -> None:
        """What a page says. What none of ours would say is passed over."""
        if self._recording and isinstance(on := message.get("record"), bool):
            (self._recording.start if on else self._recording.stop)()
            self._say_time()
        if self._give is None or "order" not in message:
            return
        try:
            wish = msgspec.convert(message["order"], Wish)
            seen = {robot: (int(start), int(sent)) for robot, (start, sent) in wish.seen.items()}
        except (msgspec.ValidationError, ValueError):
            return
        under_way = self._under_way[wish.verb in URGENT]
        if wish.robots and set(wish.robots) <= set(self._fleet.robot) and len(under_way) < UNDER_WAY:
            task = asyncio.create_task(self._order(self._give, wish, seen))
            under_way.add(task)
            task.add_done_callback(under_way.discard)

    async def _order(self, give: Give, wish: Wish, seen: Seen) -> None:
        """Give it in a thread of its own, since it waits, and say on every page what comes of it."""
        loop, note = asyncio.get_running_loop(), {"n": next(self._numbers)}
        order = {"verb": wish.verb, "args": wish.args, "asked": wish.robots, "at_ms": self._now_ms()}
        self._board.say(text({"k": "order", **note, **order}))

        def give_it() -> None:
            for reply in give(wish.robots, wish.verb, wish.args, seen):
                outcome = {"k": "outcome", **note, **reply._asdict(), "at_ms": self._now_ms()}
                loop.call_soon_threadsafe(self._board.say, text(outcome))

        try:
            await loop.run_in_executor(self._threads[wish.verb in URGENT], give_it)
        except Refusal as refusal:  # nothing went out
            self._board.say(text({"k": "outcome", **note, "trouble": str(refusal), "at_ms": self._now_ms()}))


# --- orders from the page ---
# Orders of the person at the page: through a console, by the states that the page has shown.

BEHIND_NS = 3_000_000_000  # robots refuse what goes by an older State, too


def give(console: OrderConsole, robots: list[str], verb: str, args: Mapping[str, Any], seen: Seen) -> Iterator[Reply]:
    """Order, and tell what comes of it at each robot as it comes. Raises Refusal for what cannot be ordered, or was
    decided by an old page.

    What a page shows may be older than what has reached this process: it was frozen, or its browser is far away. And
    this process may have slept itself: robots are told what the page showed, and refuse what is too old.
    """
    if verb not in (*URGENT, CLOCK):
        newest = console.states()
        for robot, looked_at in seen.items():
            if robot in newest and _is_behind(looked_at, newest[robot]):
                raise Refusal("clock", f"the page showed {robot} as it was seconds ago; look at it, and order again")
    everybody = verb in URGENT and console.robots <= set(robots)
    for robot, outcome in console.orders(robots, verb, args, everybody=everybody, seen=seen):
        answer = outcome.answer
        if answer is None:
            yield Reply(robot, None, outcome.why, "")
        else:
            yield Reply(robot, answer.ok, answer.why, str(answer.id))


def _is_behind(looked_at: tuple[int, int], newest: State) -> bool:
    incarnation, sent_ns = looked_at
    return newest.incarnation != incarnation or newest.sent_ns - sent_ns > BEHIND_NS
