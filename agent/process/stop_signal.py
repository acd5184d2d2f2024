"""How a command that runs until it is ended learns that it shall end."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Condition, Event, RLock

AGAIN_S = 0.5  # a wait without end looks as often by itself

_asked: list[int] = []  # signals that came while nobody waited for one yet


class Stop(Event):
    """An event that a signal may set. Its handler runs in the main thread, maybe in the middle of a wait for this very
    event: threading's own would then wait for its own lock for ever."""

    def __init__(self) -> None:
        super().__init__()
        self._changed = Condition(RLock())
        self._happened = False

    def is_set(self) -> bool:
        return self._happened

    def set(self) -> None:
        with self._changed:
            self._happened = True
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """A signal between the look and the sleep goes unheard by this sleep, so none is without end."""
        with self._changed:
            while not self._happened:
                self._changed.wait(AGAIN_S if timeout is None else timeout)
                if timeout is not None:
                    break
        return self._happened


def leave(number: int, frame: object) -> None:
    """A signal ends the program as Ctrl-C does, so that what it started ends with it.

    Where Python runs a callback, as it often does while it imports, an exception is told and forgotten: then
    `until_signal` remembers.
    """
    _asked.append(number)
    raise SystemExit(128 + number)


@contextmanager
def until_signal() -> Iterator[Event]:
    """An event that Ctrl-C, SIGTERM and a terminal that is closed set; a second one interrupts whatever still runs."""
    stop = Stop()
    if _asked:
        stop.set()

    def handle(number: int, frame: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    ours = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup means it
        ours.append(signal.SIGHUP)
    before = {number: signal.signal(number, handle) for number in ours}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
