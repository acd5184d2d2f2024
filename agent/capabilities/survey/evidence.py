"""The map of what was seen: for each cell a sum of integers over the keyframes that are held.

Sums of integers do not depend on the order in which keyframes came, nor on how often: which are held is known by their
keys. Of two different ones under one key (their origin lies) that with the smaller bytes counts, and of each origin
its newest STARTS incarnations: both are the same whatever came first.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable
from typing import NamedTuple

import msgspec

from agent.capabilities.survey.free_space import is_free, passed
from agent.capabilities.survey.grid import FARTHEST_M, FLOOR_MM, NEAREST_M, Grid, information, is_inner
from agent.capabilities.survey.rays import along, block_slopes, place_m, rotation
from agent.core.capability_messages import UNIT_M, Frame, measured
from agent.core.messages import Vector
from agent.core.step_transaction import Revertible

STARTS = 4
ALONE_COS = 0.7  # of a block without neighbours that tell how its surface lies
Key = tuple[str, int, int]  # origin, incarnation, number
Dose = tuple[tuple[int, int], ...]  # cells and what is added to them


class Landed(NamedTuple):
    """A block whose depth counts."""

    number: int  # of the cell
    weight: int  # information


class Held(NamedTuple):
    frame: Frame
    bytes: bytes  # which of two different ones is first


class CoverageMap(Revertible):
    """Of one robot, between steps."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.held: dict[Key, Held] = {}
        self.cells: dict[int, int] = {}  # information, grid.ONE per mm^2
        self.hits: dict[int, int] = {}  # blocks that end in each cell
        self.passes: dict[int, int] = {}  # and that look through it
        self.starts: dict[str, tuple[int, ...]] = {}  # incarnations of each origin, newest first
        self.version = 0  # counts changes
        self._share: tuple[int, float] | None = None  # of which version, and what it is
        self._digest: tuple[int, str] | None = None
        self._solid: tuple[int, frozenset[int]] | None = None

    def add(self, frame: Frame) -> bool:
        """Take a keyframe in whose content was found to be possible; returns whether it changes anything."""
        if not self._counts(frame.origin, frame.incarnation):
            return False
        key, held = (frame.origin, frame.incarnation, frame.number), Held(frame, as_bytes(frame))
        before = self.held.get(key)
        if before is not None and before.bytes <= held.bytes:
            return False
        if before is not None:
            self._sum(before.frame, -1)
        self.held[key] = held
        self._sum(frame, 1)
        self.version += 1
        return True

    def has(self, key: Key) -> bool:
        return key in self.held

    def share(self) -> float:
        """Of the wanted cells, and of things within the tank that were found, how many are known well enough."""
        if self._share is None or self._share[0] != self.version:
            goal, wanted = self.grid.goal, self.grid.wanted
            inside = self.solid() - wanted
            seen = sum(self.cells.get(n, 0) >= goal for n in wanted) + sum(self.cells[n] >= goal for n in inside)
            self._share = self.version, seen / max(len(wanted) + len(inside), 1)
        return self._share[1]

    def occupied(self, number: int) -> bool:
        """Whether something is known to be there: measured, and not looked through."""
        return 4 * self.cells.get(number, 0) >= self.grid.goal and not is_free(number, self.hits, self.passes)

    def solid(self) -> frozenset[int]:
        """Cells away from floor and walls in which something is known to be."""
        if self._solid is None or self._solid[0] != self.version:
            self._solid = self.version, frozenset(n for n in self.cells if is_inner(n, self.grid) and self.occupied(n))
        return self._solid[1]

    def as_bytes(self) -> bytes:
        """What is known of each cell, the same on every robot that holds the same keyframes. So are `hits` and
        `passes`; they are left out so that robots of other versions can compare."""
        return b"".join(
            number.to_bytes(4, "little") + total.to_bytes(8, "little") for number, total in sorted(self.cells.items())
        )

    def digest(self) -> str:
        """Sixteen hexadecimal digits of the map and of the keys of its keyframes."""
        if self._digest is None or self._digest[0] != self.version:
            keys = repr(sorted(self.held)).encode()
            self._digest = self.version, hashlib.sha256(self.as_bytes() + keys).hexdigest()[:16]
        return self._digest[1]

    def _counts(self, origin: str, incarnation: int) -> bool:
        """Whether this start of a robot is among its newest; what an older one gives way for is forgotten."""
        known = self.starts.get(origin, ())
        if incarnation in known:
            return True
        newest = tuple(sorted((*known, incarnation), reverse=True))
        self.starts[origin], gone = newest[:STARTS], newest[STARTS:]
        for key in [key for key in self.held if key[0] == origin and key[1] in gone]:
            self._sum(self.held.pop(key).frame, -1)
            self.version += 1
        return incarnation not in gone

    def _sum(self, frame: Frame, sign: int) -> None:
        blocks = landed(frame, self.grid)
        _add(self.cells, blocks, sign)
        _add(self.hits, ((block.number, 1) for block in blocks), sign)
        _add(self.passes, passed(frame, self.grid).items(), sign)


def _add(sums: dict[int, int], more: Iterable[tuple[int, int]], sign: int) -> None:
    for number, weight in more:
        total = sums.get(number, 0) + sign * weight
        if total:
            sums[number] = total
        else:
            sums.pop(number, None)


def as_bytes(frame: Frame) -> bytes:
    return msgspec.msgpack.encode(frame)


def dose(frame: Frame, grid: Grid) -> Dose:
    """What a keyframe adds to which cells: cos(incidence) / sigma^2 of each block whose depth counts."""
    found: dict[int, int] = {}
    _add(found, landed(frame, grid), 1)
    return tuple(found.items())


def landed(frame: Frame, grid: Grid) -> list[Landed]:
    """Each block whose depth counts, in its order."""
    r, at = rotation(frame.turn), place_m(frame.place)
    slopes, ahead_m, cols = block_slopes(frame.lens, len(frame.sigmas)), frame.lens.ahead * UNIT_M, frame.lens.cols
    points: dict[int, Vector] = {}
    known = measured(frame)
    for k, z_m, _ in known:
        x, y = slopes[k]
        points[k] = (x * (z_m - ahead_m), y * (z_m - ahead_m), z_m)
    found = []
    for k, z_m, sigma_m in known:
        if not NEAREST_M < z_m < FARTHEST_M:
            continue
        p = points[k]
        weight = information(_cosine(points, k, cols), max(sigma_m * 1000.0, FLOOR_MM))
        px, py, pz = along(r, (p[0] / z_m, p[1] / z_m))
        number = grid.number(at[0] + px * z_m, at[1] + py * z_m, at[2] + pz * z_m)
        if weight and number is not None:
            found.append(Landed(number, weight))
    return found


def _cosine(points: dict[int, Vector], k: int, cols: int) -> float:
    """Between the ray to a block and the normal of the surface through its neighbours."""
    p, col = points[k], k % cols
    across = _step(points, k - 1 if col > 0 else -1, k, k + 1 if col < cols - 1 else -1)
    down = _step(points, k - cols, k, k + cols)
    if across is None or down is None:
        return ALONE_COS
    nx = across[1] * down[2] - across[2] * down[1]
    ny = across[2] * down[0] - across[0] * down[2]
    nz = across[0] * down[1] - across[1] * down[0]
    length2 = (nx * nx + ny * ny + nz * nz) * (p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    if length2 <= 0.0:
        return ALONE_COS
    return abs(nx * p[0] + ny * p[1] + nz * p[2]) / math.sqrt(length2)


def _step(points: dict[int, Vector], before: int, k: int, after: int) -> Vector | None:
    a, b = points.get(before, points[k]), points.get(after, points[k])
    if a is b:
        return None
    return b[0] - a[0], b[1] - a[1], b[2] - a[2]
