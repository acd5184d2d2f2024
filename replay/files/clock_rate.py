"""How fast the clock goes by which a recording is stamped: noted twice a second of it, on the channel CLOCK.

A dive in the twin has a clock of its own, faster or slower than the wall's and not evenly so. Each note ties the two
together at one moment; between two notes a reader interpolates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import count
from typing import NamedTuple

from agent.clock import machine
from agent.clock.clock import Clock
from agent.clock.keeper import how_fast
from agent.core.codec import Refusal, decode, encode
from agent.core.messages import Message
from replay.files.backlog import Entry
from replay.files.channels import CLOCK, entry_on

PERIOD_NS = 500_000_000  # of the clock; its rate is that of its last second on the wall


class ClockRate(Message, frozen=True, kw_only=True):
    """One note; its log time is the clock's own. Where the clock is the system's the rate is 1."""

    rate: float  # seconds of the clock in a second of the wall, of late
    dive_s: float | None  # since the twin's clock began; None: there is no twin
    wall_ns: int  # Unix time by the system then, which may be corrected while the clock never steps back


class RateNotes:
    """Whoever has a loop asks it for notes; of one thread."""

    def __init__(self, clock: Clock, unix_ns: Callable[[], int] = machine.unix_ns) -> None:
        self._clock, self._unix_ns = clock, unix_ns
        self._numbers = count()
        self._period: int | None = None  # that was noted last, counted since 1970

    def due(self) -> tuple[Entry, ...]:
        """The note of this period, once; nothing until the next one begins. To be asked more often than that."""
        now_ns, wall_ns = self._clock.now_ns(), self._unix_ns()
        if now_ns // PERIOD_NS == self._period:
            return ()
        self._period = now_ns // PERIOD_NS
        start_ns = self._clock.start_ns
        dive_s = None if start_ns is None else (now_ns - start_ns) * 1e-9
        note = ClockRate(rate=self._clock.rate(), dive_s=dive_s, wall_ns=wall_ns)
        return (entry_on(CLOCK, now_ns, now_ns, next(self._numbers), encode(note)),)


class Moment(NamedTuple):
    """A note as a recording has it."""

    now_ns: int  # by the clock
    noted: ClockRate


def moment(log_time_ns: int, data: bytes) -> Moment | None:
    """What a message on CLOCK says; None for one of another version."""
    try:
        return Moment(log_time_ns, decode(data, ClockRate))
    except Refusal:
        return None


class Pace(NamedTuple):
    """How a dive's clock went over a recording, or over several of one dive."""

    dive_s: float
    wall_s: float
    slowest: float
    fastest: float

    def __str__(self) -> str:
        """A line for a person."""
        return how_fast(self.dive_s, self.wall_s, (self.slowest, self.fastest))


def in_dive(moments: Iterable[Moment]) -> list[Moment]:
    """Those with a twin, in order."""
    return sorted((each for each in moments if each.noted.dive_s is not None), key=lambda each: each.now_ns)


def pace(moments: Iterable[Moment]) -> Pace | None:
    """From the first to the last moment with a twin; None without one, or where the wall's clock was set back."""
    dive = in_dive(moments)
    if not dive or (wall_ns := dive[-1].noted.wall_ns - dive[0].noted.wall_ns) <= 0:
        return None
    rates = [each.noted.rate for each in dive]
    return Pace((dive[-1].now_ns - dive[0].now_ns) * 1e-9, wall_ns * 1e-9, min(rates), max(rates))
