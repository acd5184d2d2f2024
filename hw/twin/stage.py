"""What stands in the tank at each time: solids that events move, tags that events take away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from agent.core.messages import Vector
from hw.twin.landmarks import PaintedTag
from hw.twin.scene import Solid


class Move(NamedTuple):
    """One solid's way: straight, at one speed."""

    solid: int
    from_m: Vector
    to_m: Vector
    start_ns: int
    end_ns: int

    def at(self, t_ns: int) -> Vector:
        share = min(max((t_ns - self.start_ns) / (self.end_ns - self.start_ns), 0.0), 1.0)
        x, y, z = (a + share * (b - a) for a, b in zip(self.from_m, self.to_m, strict=True))
        return x, y, z


class Stage:
    """Whoever asks about a time that has not passed may get another answer later. One thread changes it."""

    def __init__(self, solids: Sequence[Solid], tags: Sequence[PaintedTag]) -> None:
        self._solids, self._tags = tuple(solids), tuple(tags)
        self._moves: list[Move] = []  # in order of time; a later one of the same solid ends the one before
        self._lost_ns: dict[int, int] = {}

    def move(self, solid: int, to_m: Vector, now_ns: int, over_s: float) -> None:
        """Move a solid from where it is, from now on."""
        here_m = self.solids(now_ns)[solid].position_m
        self._moves.append(Move(solid, here_m, to_m, now_ns, now_ns + round(over_s * 1e9)))

    def lose_tag(self, number: int, now_ns: int) -> None:
        self._lost_ns.setdefault(number, now_ns)

    def solids(self, t_ns: int) -> tuple[Solid, ...]:
        """All solids, in the order of the scene."""
        standing = list(self._solids)
        for move in self._moves:
            if t_ns >= move.start_ns:
                standing[move.solid] = msgspec.structs.replace(self._solids[move.solid], position_m=move.at(t_ns))
        return tuple(standing)

    def tags(self, t_ns: int) -> tuple[PaintedTag, ...]:
        """The tags that are still there."""
        if not self._lost_ns:
            return self._tags
        return tuple(tag for tag in self._tags if self._lost_ns.get(tag.id, t_ns + 1) > t_ns)
