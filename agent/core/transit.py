"""How long messages of one neighbour are on their way, beyond the quickest of them: clocks that differ cancel."""

from __future__ import annotations

from typing import NamedTuple

from agent.core.savepoint import Revertible

CLOCKS_NS = 3 * 3600 * 10**9  # by which the clocks of two robots may differ: nobody sets them to a common time
WINDOW_NS = 60_000_000_000  # over which the quickest message is remembered
BIN_NS = 1_000_000_000  # resolution of that memory: 60 numbers a neighbour
STEP_NS = 200_000_000  # a message that was quicker by more than this tells of another clock, or lies
LOST_NS = 60_000_000_000  # and one that was slower by more than this: links give up long before
INSISTS = 3  # such messages in a row, after which it is another clock
STEADY_NS = 50_000_000  # queues do not hold all messages up alike: who is late by the same for so long ...
STEADY_FOR_NS = 3_000_000_000  # ... had told a wrong time before


class Late(NamedTuple):
    """Messages in a row that were late."""

    since_ns: int
    least_ns: int  # transit
    most_ns: int


class Transit(Revertible):
    """Memory of one neighbour since its start."""

    def __init__(self) -> None:
        self._bins: dict[int, int] = {}  # the quickest of each second
        self._stepped = 0  # messages in a row that were too quick, or too slow to be true
        self._late: Late | None = None

    def late_ns(self, transit_ns: int, arrived_ns: int) -> int:
        """How long a message was queued; transit_ns: its arrival on our clock less its stamp on the sender's."""
        late_ns = transit_ns - min(self._bins.values(), default=transit_ns)
        self._stepped = self._stepped + 1 if not -STEP_NS <= late_ns <= LOST_NS else 0
        if 0 < self._stepped < INSISTS:
            return max(0, late_ns)
        if self._stepped or (late_ns > STEP_NS and self._steady(transit_ns, arrived_ns)):
            self._bins, self._stepped = {}, 0
        if late_ns <= STEP_NS:
            self._late = None
        now_bin = arrived_ns // BIN_NS
        self._bins[now_bin] = min(transit_ns, self._bins.get(now_bin, transit_ns))
        for old in [b for b in self._bins if b < now_bin - WINDOW_NS // BIN_NS]:
            del self._bins[old]
        return transit_ns - min(self._bins.values())

    def _steady(self, transit_ns: int, arrived_ns: int) -> bool:
        """Whether all have long been late by the same."""
        since_ns, least_ns, most_ns = self._late or Late(arrived_ns, transit_ns, transit_ns)
        least_ns, most_ns = min(least_ns, transit_ns), max(most_ns, transit_ns)
        if most_ns - least_ns > STEADY_NS:
            since_ns, least_ns, most_ns = arrived_ns, transit_ns, transit_ns
        self._late = Late(since_ns, least_ns, most_ns)
        return arrived_ns - since_ns >= STEADY_FOR_NS
