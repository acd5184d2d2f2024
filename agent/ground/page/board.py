"""What a page shows now, and what each open page has not been sent yet.

One message of a key is on its way to a page at any time: the next one goes when the page says that it has drawn the
last, and is then the newest that there is. A page that was frozen for seconds is thus at most one message behind, where
a queue, or the sockets' own, would play to it what happened meanwhile.
"""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable, Iterable

import msgspec

from agent.core.codec import Refusal
from agent.ground.page.rows import Shown, text

LINES_KEY = "lines"  # the key of what is a queue: log, orders, answers
CAME = "came"  # the key of what came of a recording, whatever time of it is shown
KEPT = 400  # lines that whoever opens the page later still sees
MOST_KEYS = 1024

Make = Callable[[], Shown]


class Item:
    """The newest of a key: made when somebody wants it, and once."""

    __slots__ = ("_made", "_make")

    def __init__(self, make: Make) -> None:
        self._make = make
        self._made: Shown | None = None

    def made(self) -> Shown:
        if self._made is None:
            self._made = self._make()
        return self._made


class Viewer:
    """One open page: which keys it has not seen the newest of, and which it has not acknowledged."""

    def __init__(self) -> None:
        self.news = asyncio.Event()
        self.waiting: dict[str, None] = {}  # a set that keeps its order
        self.owed: set[str] = set()
        self.lines: deque[msgspec.Raw] = deque(maxlen=KEPT)

    def due(self) -> str | None:
        """The key to send next; None: there is nothing, or the page has not drawn what it got."""
        return next((key for key in self.waiting if key not in self.owed), None)

    def got(self, keys: Iterable[str]) -> None:
        """What the page has drawn."""
        self.owed.difference_update(keys)
        self.news.set()

    def wants(self, key: str) -> None:
        self.waiting[key] = None
        if key not in self.owed:
            self.news.set()


class Board:
    """Used from one thread, that of the event loop."""

    def __init__(self) -> None:
        self.refused = 0  # messages that are none: not shown
        self._newest: dict[str, Item] = {}
        self._lines: deque[msgspec.Raw] = deque(maxlen=KEPT)
        self._viewers: set[Viewer] = set()

    def show(self, key: str, make: Make) -> None:
        """In place of what was shown of this key."""
        if key not in self._newest and len(self._newest) >= MOST_KEYS:
            return
        self._newest[key] = Item(make)
        for viewer in self._viewers:
            viewer.wants(key)

    def say(self, line: Shown) -> None:
        """Behind the lines that were said; a line is a message of the page as well."""
        raw = msgspec.Raw(line.encode() if isinstance(line, str) else line)
        self._lines.append(raw)
        for viewer in self._viewers:
            viewer.lines.append(raw)
            viewer.wants(LINES_KEY)

    def start_over(self) -> None:
        """Nothing is shown: another time of a recording follows."""
        kept = {key: item for key, item in self._newest.items() if key in ("hello", "clock", CAME)}
        self._newest = kept
        self._lines.clear()
        for viewer in self._viewers:
            viewer.waiting = {key: None for key in viewer.waiting if key in kept}
            viewer.lines.clear()
            viewer.owed.clear()  # else what follows could come to a page before it hears that it starts over
        self.show("over", lambda: text({"k": "over"}))

    def join(self) -> Viewer:
        """A page that was opened: all that there is will be sent to it."""
        viewer = Viewer()
        viewer.lines.extend(self._lines)
        for key in self._newest:
            viewer.wants(key)
        if viewer.lines:
            viewer.wants(LINES_KEY)
        self._viewers.add(viewer)
        return viewer

    def leave(self, viewer: Viewer) -> None:
        self._viewers.discard(viewer)

    def next_for(self, viewer: Viewer) -> list[Shown]:
        """The next messages to this page, which owes an answer for each from now on."""
        found = []
        while (key := viewer.due()) is not None:
            del viewer.waiting[key]
            try:
                found.append(self._lines_for(viewer) if key == LINES_KEY else self._newest[key].made())
            except Refusal:
                self.refused += 1
                self._newest.pop(key)
            except KeyError:  # refused to another page
                continue
            else:
                viewer.owed.add(key)
        return found

    def _lines_for(self, viewer: Viewer) -> Shown:
        lines = list(viewer.lines)
        viewer.lines.clear()
        return text({"k": LINES_KEY, "lines": lines})
