"""How far the clocks of other robots are from ours, and how old their words are: nothing sets them to a common time.

Of a neighbour the quickest message tells how long others were queued (`Transit`), and stamps that it echoes tell its
clock to within half a round trip (`LinkClock`). Of a robot further off its samples tell (`OriginClocks`).
"""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

from agent.core.step_transaction import Revertible

# --- time in transit ---
# How long messages of one neighbour are on their way, beyond the quickest of them: clocks that differ cancel.

CLOCKS_NS = 3 * 3600 * 10**9  # by which the clocks of two robots may differ: nothing sets them to a common time
WINDOW_NS = 60_000_000_000  # over which the quickest message is remembered
BIN_NS = 1_000_000_000  # resolution of that memory: 60 numbers a neighbour
STEP_NS = 200_000_000  # a message that was quicker by more than this tells of another clock, or lies
LOST_NS = 60_000_000_000  # so does one that was slower by more than this: links give up long before
INSISTS = 3  # such messages in a row, after which it is another clock
STEADY_NS = 50_000_000  # queues do not hold all messages up alike: where all are late by the same, to within this, ...
STEADY_FOR_NS = 3_000_000_000  # ... for so long, the clock of the sender was wrong before


T = TypeVar("T", int, "RoundTrip")


class LeastOfMinute(Revertible, Generic[T]):
    """The least of what the last minute brought, for neighbouring seconds one by one."""

    def __init__(self) -> None:
        self._bins: dict[int, T] = {}  # the least of each second

    def least(self) -> T | None:
        return min(self._bins.values(), default=None)

    def add(self, new: T, at_ns: int) -> None:
        now_bin = at_ns // BIN_NS
        self._bins[now_bin] = min(new, self._bins.get(now_bin, new))
        for old in [b for b in self._bins if b < now_bin - WINDOW_NS // BIN_NS]:
            del self._bins[old]

    def forget(self) -> None:
        self._bins = {}


class Late(NamedTuple):
    """Messages in a row that were late, since the first of them."""

    since_ns: int
    least_ns: int  # transit
    most_ns: int


class Transit(Revertible):
    """The quickest messages of one neighbour since its start."""

    def __init__(self) -> None:
        self._quickest = LeastOfMinute[int]()
        self._stepped = 0  # messages in a row that were too quick, or too slow to be true
        self._late: Late | None = None

    def late_ns(self, transit_ns: int, arrived_ns: int) -> int:
        """How long a message was queued; transit_ns: its arrival on our clock less its stamp on the sender's."""
        quickest_ns = self._quickest.least()
        late_ns = 0 if quickest_ns is None else transit_ns - quickest_ns
        self._stepped = self._stepped + 1 if not -STEP_NS <= late_ns <= LOST_NS else 0
        if 0 < self._stepped < INSISTS:
            return max(0, late_ns)
        if self._stepped or (late_ns > STEP_NS and self._steady(transit_ns, arrived_ns)):
            self._quickest.forget()
            self._stepped = 0
        if late_ns <= STEP_NS:
            self._late = None
        self._quickest.add(transit_ns, arrived_ns)
        return transit_ns - (self._quickest.least() or 0)

    def _steady(self, transit_ns: int, arrived_ns: int) -> bool:
        """Whether all messages have long been late by the same."""
        since_ns, least_ns, most_ns = self._late or Late(arrived_ns, transit_ns, transit_ns)
        least_ns, most_ns = min(least_ns, transit_ns), max(most_ns, transit_ns)
        if most_ns - least_ns > STEADY_NS:
            since_ns, least_ns, most_ns = arrived_ns, transit_ns, transit_ns
        self._late = Late(since_ns, least_ns, most_ns)
        return arrived_ns - since_ns >= STEADY_FOR_NS


# --- clock of a neighbour ---
# A delay that is the same for all messages does not show in when they arrive. It shows in how long an echo takes:
# each message says which stamp of its reader it heard last, and how long ago that arrived (as NTP and TCP do).
#
# rtt = arrival - echoed stamp - held ;  ours minus theirs lies in [transit - rtt, transit]
#
# The quickest round trip of a minute counts, and the middle of its interval: half of it is what nobody can know, for
# the way there and the way back need not take the same time.

AGREE_NS = 20_000_000  # intervals that miss each other by more are of two clocks: one of them was set
NEGATIVE_NS = 5_000_000  # a round trip that ended so long before it began is a lie, or spans a step of our clock


class RoundTrip(NamedTuple):
    """One message that echoed a stamp of ours."""

    rtt_ns: int
    transit_ns: int  # its arrival on our clock less its stamp on the sender's


class Way(NamedTuple):
    """What a message's way took, as far as it can be known."""

    late_ns: int
    bound_ns: int  # by which that may be wrong, both ways


class LinkClock(Revertible):
    """The clock of one neighbour since its start."""

    def __init__(self) -> None:
        self._quickest = LeastOfMinute[RoundTrip]()

    def hear(self, echo: tuple[int, int] | None, transit_ns: int, arrived_ns: int) -> None:
        """A message came; echo: the stamp of ours that it heard last, and for how long it has held that, ns."""
        if echo is None or (rtt_ns := arrived_ns - echo[0] - echo[1]) < -NEGATIVE_NS:
            return
        new, quickest = RoundTrip(max(rtt_ns, 0), transit_ns), self._quickest.least()
        if quickest is not None and not _meet(new, quickest):
            self._quickest.forget()
        self._quickest.add(new, arrived_ns)

    def way(self, transit_ns: int) -> Way | None:
        """Of a message that took transit_ns by both clocks; None before the first echo."""
        quickest = self._quickest.least()
        if quickest is None:
            return None
        clock_ns = quickest.transit_ns - quickest.rtt_ns // 2
        return Way(max(0, transit_ns - clock_ns), quickest.rtt_ns // 2)


def _meet(a: RoundTrip, b: RoundTrip) -> bool:
    """Whether one offset of the clocks explains both."""
    lowest, highest = max(a.transit_ns - a.rtt_ns, b.transit_ns - b.rtt_ns), min(a.transit_ns, b.transit_ns)
    return lowest <= highest + AGREE_NS


# --- clocks of origins ---
# When a sample was taken, on our clock: what its origin's clock said then, plus how far that clock is from ours.
#
# Each copy of a sample tells an offset of its own: its time of arrival less its age less its origin's stamp. Delays
# that are unaccounted for make it too large, a relay that lies may make it anything. So the first copy that comes from
# the origin itself decides, else the first relay; from then on the offset moves no faster than clocks drift. A clock
# that was set, or is slewed faster than that, is another clock: its own robot insists on it, and is believed.

DRIFT = 1e-3  # the offset falls no faster than this, as shorter delays are found; no quartz is as bad
RISE = 1e-4  # it rises so fast where all delays seem to have become longer: the worst drift of two quartzes


class Offset(NamedTuple):
    """Our clock minus the origin's."""

    offset_ns: int
    bound_ns: int  # by which it may be wrong
    at_ns: int
    direct: bool  # by a message of the origin itself


class OriginClocks(Revertible):
    """What one robot knows of the clocks of all origins."""

    def __init__(self) -> None:
        self._offsets: dict[str, Offset] = {}
        self._missed: dict[str, int] = {}  # by each origin itself, in a row: what cannot have this offset

    def offset(self, origin: str, said_ns: int, bound_ns: int, direct: bool, now_ns: int) -> Offset:
        """The offset to count with, after a copy that says `said_ns`, to within `bound_ns`, came."""
        old = self._offsets.get(origin)
        if old is not None and direct and old.direct:
            missed = abs(said_ns - old.offset_ns) > bound_ns + old.bound_ns + AGREE_NS
            self._missed[origin] = self._missed.get(origin, 0) + 1 if missed else 0
            if self._missed[origin] >= INSISTS:
                self._missed[origin], old = 0, None
        if old is None or (direct and not old.direct) or (direct == old.direct and _nearer(said_ns, bound_ns, old)):
            new = Offset(said_ns, bound_ns, now_ns, direct)
        else:
            elapsed_ns = max(0, now_ns - old.at_ns)
            highest = old.offset_ns + round(RISE * elapsed_ns)
            lowest = old.offset_ns - round(DRIFT * elapsed_ns)
            new = old._replace(offset_ns=max(lowest, min(highest, said_ns)), at_ns=now_ns)
        self._offsets[origin] = new
        return new


def _nearer(said_ns: int, bound_ns: int, old: Offset) -> bool:
    """Whether an offset is known better than before, and may be the same."""
    return bound_ns < old.bound_ns and abs(said_ns - old.offset_ns) <= old.bound_ns + AGREE_NS
