"""Who of a fleet is heard and who is not, for a person who waits for it: said once, and again when it changes."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable

from agent.clock import machine
from agent.core.config import Fleet

SILENCE_S = 3.0  # of the wall: a fleet's own clock stands while there is no twin. Links are up within one
NAMED = 5  # robots in a line


class RollCall:
    """`look` is given the names of all who were heard so far, again and again; `say` gets a line for a person."""

    def __init__(self, fleet: Fleet, say: Callable[[str], None]) -> None:
        self._fleet, self._say = fleet, say
        self._told: frozenset[str] | None = None  # who was heard when it was last said; None: too early to tell
        self._until_s = machine.monotonic_s() + SILENCE_S

    def look(self, heard: Collection[str]) -> None:
        """Say after a while who is missing, and then who has come for the first time."""
        now = frozenset(self._fleet.robot).intersection(heard)
        if self._told is None:
            if machine.monotonic_s() >= self._until_s:
                self._told = now
                if line := self._first_line():
                    self._say(line)
        elif new := now - self._told:
            self._told = now
            missing = f"; still not heard: {self._where(self._missing())}" if self._missing() else "; that is all"
            self._say(f"{', '.join(sorted(new))} is heard now{missing}")

    def end(self) -> None:
        """Say who is still missing."""
        if self._told is not None and self._missing():
            self._say(f"never heard: {self._where(self._missing())}")

    def _missing(self) -> list[str]:
        return [name for name in self._fleet.robot if name not in (self._told or ())]

    def _first_line(self) -> str | None:
        if not self._missing():
            return None
        where = self._where(self._missing())
        if not self._told:
            return (
                f"nobody of fleet '{self._fleet.fleet}' is heard yet: {where}; start the agents, or give the fleet "
                f"file that they were started with"
            )
        return f"not heard yet: {where}; start it with aucamp agent, or correct its address in the fleet file"

    def _where(self, names: Iterable[str]) -> str:
        said = [f"{name} at {self._fleet.robot[name].listen}" for name in names]
        return ", ".join(said if len(said) <= NAMED else [*said[:NAMED], f"{len(said) - NAMED} more"])
