"""Who is linked to a robot of a secured fleet and has no business there: somebody with a certificate of our authority.

The access rules believe them nothing and tell them nothing, and say so to nobody: people are told here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from agent.core.config import Fleet
from router_config.door import Link

LOOK_S = 1.0  # between two looks: one costs 0.01 ms with ten links
NAMED = 4


class Strangers:
    """`faults` is called in the loop, and looks once a second."""

    def __init__(self, fleet: Fleet, robot: str) -> None:
        access = fleet.access
        self._known = {*fleet.robot[robot].neighbours, *access.observers, *access.consoles} if fleet.secured else None
        self._robots = frozenset(fleet.robot)
        self._told: tuple[str, ...] = ()
        self._look_s: float | None = None

    def faults(self, links: Callable[[], Sequence[Link]], now_s: float) -> tuple[str, ...]:
        """What is wrong, as "kind: what to do", by the links that there are now; nothing in an open fleet."""
        if self._known is None or (self._look_s is not None and now_s - self._look_s < LOOK_S):
            return self._told
        self._look_s = now_s
        strangers = sorted({link.name or "somebody without a name" for link in links()} - self._known)
        self._told = tuple(f"stranger: {self._what(name)}" for name in strangers[:NAMED])
        return self._told

    def _what(self, name: str) -> str:
        linked = f"{name} is linked to us, is believed nothing and told nothing"
        if name in self._robots:
            return f"{linked}, for it is no neighbour; look who dials with its certificate, or whose file differs"
        return f"{linked}: its certificate is ours, its name in no fleet file; end it, or add the name to [access]"
