"""When a sample was taken, on our clock: what its origin's clock said then, plus how far that clock is from ours.

Each copy of a sample tells an offset of its own: its time of arrival less its age less its origin's stamp. Ways that
are unaccounted for make it too large, a relay that lies may make it anything. So the origin's own mouth decides, else
the first relay; from then on the offset moves no faster than clocks drift.
"""

from __future__ import annotations

from typing import NamedTuple

from agent.core.savepoint import Revertible

DRIFT = 1e-3  # the offset falls no faster than this, as better ways are found; no quartz is as bad
RISE = 1e-4  # and rises so fast where all ways seem to have become longer: the worst drift of two quartzes


class Offset(NamedTuple):
    """Ours minus the origin's clock."""

    offset_ns: int
    at_ns: int
    direct: bool  # from its own mouth


class OriginClocks(Revertible):
    """What one robot knows of the clocks of all others."""

    def __init__(self) -> None:
        self._offsets: dict[str, Offset] = {}

    def offset_ns(self, origin: str, said_ns: int, direct: bool, now_ns: int) -> int:
        """The offset to count with, after a copy that says `said_ns` came."""
        old = self._offsets.get(origin)
        if old is None or (direct and not old.direct):
            new = Offset(said_ns, now_ns, direct)
        else:
            elapsed_ns = max(0, now_ns - old.at_ns)
            highest = old.offset_ns + round(RISE * elapsed_ns)
            lowest = old.offset_ns - round(DRIFT * elapsed_ns)
            new = Offset(max(lowest, min(highest, said_ns)), now_ns, old.direct)
        self._offsets[origin] = new
        return new.offset_ns
