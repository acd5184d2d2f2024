"""The map of what was seen: for each cell a sum of integers over the keyframes that are held.

Sums of integers do not depend on the order in which keyframes came, nor on how often: which are held is known by their
keys. Of two different ones under one key (their origin lies) that with the smaller bytes counts, and of each origin
its newest STARTS incarnations: both are the same whatever came first. What another robot says of an origin, unsigned,
takes a free place and never that of something held; the word of the origin itself goes before it.

A keyframe takes milliseconds to add, and as long to take out. What neighbours say is added, and starts that give way
are let go, by SUMS keyframes a step.

The tank is cut into cells first; then come the directions of a picture's blocks, and where the water is known to be
empty.
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from typing import NamedTuple

import msgspec

from agent.core.capability_messages import BEND_ONE, PX_ONE, TURN_ONE, UNIT_M, Frame, Lens, Place, Quaternion, measured
from agent.core.config import Coverage, Face, Fleet
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Rotation
from agent.core.step_transaction import Revertible

# --- grid ---
# The tank cut into cells, each with a number of its own, and which of them are wanted.

ONE = 1_000_000  # of information: 1 / mm^2
NEAREST_M, FARTHEST_M = 0.12, 1.5  # depths that count
STEEPEST = 0.15  # cosine between a surface's normal and the ray: what is more aslant does not count
FLOOR_MM = 2.0  # least standard deviation of a block, whatever it says
SIGMA_AT_M, SIGMA_UNIT_MM = 0.5, 0.01  # of what a camera says of its blocks


class Grid(NamedTuple):
    """x fastest, then y, then z."""

    cell_m: float
    shape: tuple[int, int, int]
    size_m: Vector  # of the water: length, breadth, height of the surface
    goal: int  # information of a cell that is seen well enough
    wanted: frozenset[int]  # cells of the faces that shall be seen

    def number(self, x: float, y: float, z: float) -> int | None:
        """The cell of a place; what a measurement puts up to a cell outside is on the wall. None: farther outside."""
        nx, ny, nz = self.shape
        i, j, k = _floor(x / self.cell_m), _floor(y / self.cell_m), _floor(z / self.cell_m)
        if not (-1 <= i <= nx and -1 <= j <= ny and -1 <= k < nz):
            return None
        i, j, k = min(max(i, 0), nx - 1), min(max(j, 0), ny - 1), max(k, 0)
        return i + nx * (j + ny * k)


def grid_of(fleet: Fleet) -> Grid:
    """Of a fleet with [coverage]. A rest of less than half a cell counts with the cell before it: by itself it would be
    a layer beyond the wall, or so thin that nothing in it gets known."""
    assert fleet.coverage is not None
    length, breadth, _ = fleet.tank.size_m
    size_m = length, breadth, fleet.tank.surface_m
    cell_m = fleet.coverage.cell_mm * 1e-3
    x, y, z = (max(int(side / cell_m + 0.5), 1) for side in size_m)
    faces = frozenset(number for face in fleet.coverage.faces for number in _face(face, (x, y, z)))
    return Grid(cell_m, (x, y, z), size_m, goal_information(fleet.coverage), faces)


def goal_information(coverage: Coverage) -> int:
    return round(ONE / (coverage.goal_mm * coverage.goal_mm))


def information(cos: float, sigma_mm: float) -> int:
    """What a block tells about the cell that it shows: cos / sigma^2, rounded once."""
    if cos <= STEEPEST:
        return 0
    return int(cos * ONE / (sigma_mm * sigma_mm) + 0.5)


def expected_mm(z_m: float, sigma: int) -> float:
    """Standard deviation of a block at that depth, before it was measured: equal lens steps are equal steps in
    dioptres, so that it grows with the square of the depth. sigma: at SIGMA_AT_M, in units of SIGMA_UNIT_MM."""
    far = z_m / SIGMA_AT_M
    return max(sigma * SIGMA_UNIT_MM * far * far, FLOOR_MM)


def is_inner(number: int, grid: Grid) -> bool:
    """Whether a cell is on none of the tank's faces."""
    nx, ny, _ = grid.shape
    i, j = number % nx, number // nx % ny
    return number >= nx * ny and 0 < i < nx - 1 and 0 < j < ny - 1


def _face(face: Face, shape: tuple[int, int, int]) -> Iterator[int]:
    nx, ny, nz = shape
    xs, ys, zs = range(nx), range(ny), range(nz)
    if face == "floor":
        zs = range(1)
    elif face[0] == "x":
        xs = range(1) if face == "x0" else range(nx - 1, nx)
    else:
        ys = range(1) if face == "y0" else range(ny - 1, ny)
    return (i + nx * (j + ny * k) for k in zs for j in ys for i in xs)


def _floor(value: float) -> int:
    whole = int(value)
    return whole - 1 if value < whole else whole


# --- directions of blocks ---
# Where the blocks of a picture look, by + - * / and square roots alone: alike on every processor.

UNBEND = 8  # passes that take the bend out of a slope, as in core/ranging/camera_model.py
Slopes = tuple[tuple[float, float], ...]


@lru_cache(maxsize=4)  # of one keyframe they are asked for twice
def block_slopes(lens: Lens, count: int) -> Slopes:
    """(x, y) / (z - ahead) of the middle of each block, row by row."""
    return tuple(slope(lens, k % lens.cols + 0.5, k // lens.cols + 0.5) for k in range(count))


def slope(lens: Lens, col: float, row: float) -> tuple[float, float]:
    """Of a place in the grid, counted in blocks from its upper left corner."""
    f, bend = lens.f / PX_ONE, lens.bend / BEND_ONE
    seen_x, seen_y = (col * lens.block - lens.cx / PX_ONE) / f, (row * lens.block - lens.cy / PX_ONE) / f
    x, y = seen_x, seen_y
    for _ in range(UNBEND):
        stretch = 1.0 + bend * (x * x + y * y)
        stretch = max(stretch, 0.1)
        x, y = seen_x / stretch, seen_y / stretch
    return x, y


def rotation(turn: Quaternion) -> Rotation:
    """Camera to world, of a quaternion times any factor."""
    w, x, y, z = (float(q) / TURN_ONE for q in turn)
    two = 2.0 / (w * w + x * x + y * y + z * z)
    return (
        (1.0 - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)),
        (two * (x * y + w * z), 1.0 - two * (x * x + z * z), two * (y * z - w * x)),
        (two * (x * z - w * y), two * (y * z + w * x), 1.0 - two * (x * x + y * y)),
    )


def quaternion(r: Rotation) -> Quaternion:
    """The turn as it travels, w not negative (Shepperd 1978: the largest component first)."""
    (a, b, c), (d, e, f), (g, h, i) = r
    squares = (1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i)
    most = max(range(4), key=lambda k: squares[k])
    s = 0.5 / math.sqrt(squares[most])
    found = (
        (0.25 / s, (h - f) * s, (c - g) * s, (d - b) * s),
        ((h - f) * s, 0.25 / s, (b + d) * s, (c + g) * s),
        ((c - g) * s, (b + d) * s, 0.25 / s, (f + h) * s),
        ((d - b) * s, (c + g) * s, (f + h) * s, 0.25 / s),
    )[most]
    sign = -1.0 if found[0] < 0.0 else 1.0
    w, x, y, z = (round(sign * q * TURN_ONE) for q in found)
    return w, x, y, z


def place_m(place: Place) -> Vector:
    x, y, z = (at * UNIT_M for at in place)
    return x, y, z


def along(r: Rotation, s: tuple[float, float]) -> Vector:
    """World direction of a slope, per metre of depth."""
    x, y = s
    return (
        r[0][0] * x + r[0][1] * y + r[0][2],
        r[1][0] * x + r[1][1] * y + r[1][2],
        r[2][0] * x + r[2][1] * y + r[2][2],
    )


def places_m(frame: Frame) -> list[tuple[int, Vector, float, float]]:
    """Of each block that has a depth: index, place in the world, z-depth and sigma, m."""
    r, at = rotation(frame.turn), place_m(frame.place)
    slopes, ahead_m = block_slopes(frame.lens, len(frame.sigmas)), frame.lens.ahead * UNIT_M
    found = []
    for k, z_m, sigma_m in measured(frame):
        x, y = (s * (z_m - ahead_m) / z_m for s in slopes[k])
        way = along(r, (x, y))
        found.append((k, (at[0] + z_m * way[0], at[1] + z_m * way[1], at[2] + z_m * way[2]), z_m, sigma_m))
    return found


# --- free space ---
# Where nothing is: cells that a camera looked through to what it measured behind them.
#
# A block's depth is now and then quite wrong, mostly too near, where the curve of its clarity has a second peak; it
# says that it is sure, for what is near is measured well. So one block puts a thing into the open water. What tells
# it from a thing that is there is that the others look through. In a dive of `aucamp demo --fleet survey` (seed 3)
# eight and more did for each that ended there, in nine of ten such cells; where something truly was, 3.5 and fewer in
# three of four. Blocks are counted, not weighed, in integers, which do not depend on the order in which keyframes
# came.

FREE = 6  # cells that more than so many blocks look through for each that ends there are empty
EVERY = 2  # of the blocks, across and down: each stands for EVERY^2
SHORT = 3.0  # a ray is open water as far as so many standard deviations before its end
FAR_M = 1e9


def passed(frame: Frame, grid: Grid) -> dict[int, int]:
    """How many blocks look through each cell away from floor and walls, which are known to be there."""
    r, at = rotation(frame.turn), place_m(frame.place)
    slopes, ahead_m, cols = block_slopes(frame.lens, len(frame.sigmas)), frame.lens.ahead * UNIT_M, frame.lens.cols
    start = at[0] + r[0][2] * ahead_m, at[1] + r[1][2] * ahead_m, at[2] + r[2][2] * ahead_m
    found: dict[int, int] = {}
    for k, z_m, sigma_m in measured(frame):
        if k % cols % EVERY or k // cols % EVERY or not NEAREST_M < z_m < FARTHEST_M:
            continue
        way, depth_m = along(r, slopes[k]), z_m - ahead_m
        there = start[0] + way[0] * depth_m, start[1] + way[1] * depth_m, start[2] + way[2] * depth_m
        own = grid.number(*there)
        for number in crossed(start, way, depth_m - max(SHORT * sigma_m, 0.5 * grid.cell_m), grid):
            if number != own:
                found[number] = found.get(number, 0) + EVERY * EVERY
    return {number: count for number, count in found.items() if is_inner(number, grid)}


def crossed(at: Vector, way: Vector, depth_m: float, grid: Grid) -> list[int]:
    """Cells on the way from a place in the water to a depth, world direction per metre of it, in their order; as far as
    the water reaches (Amanatides and Woo, as in candidates.cast)."""
    if not all(0.0 < p < size for p, size in zip(at, grid.size_m, strict=True)):
        return []
    nx, ny, _ = grid.shape
    index, nexts, ends, strides = 0, [], [], []
    for axis, (p, w, size, stride) in enumerate(zip(at, way, grid.size_m, (1, nx, nx * ny), strict=True)):
        k = min(int(p / grid.cell_m), grid.shape[axis] - 1)
        index += k * stride
        if w == 0.0:
            nexts.append(FAR_M)
            ends.append(FAR_M)
        else:
            nexts.append(((k + (w > 0.0)) * grid.cell_m - p) / w)
            ends.append(grid.cell_m / abs(w))
            depth_m = min(depth_m, ((size if w > 0.0 else 0.0) - p) / w)
        strides.append(stride if w > 0.0 else -stride)
    tx, ty, tz = nexts
    found = [index]
    while True:
        if tx <= ty and tx <= tz:
            reached, index, tx = tx, index + strides[0], tx + ends[0]
        elif ty <= tz:
            reached, index, ty = ty, index + strides[1], ty + ends[1]
        else:
            reached, index, tz = tz, index + strides[2], tz + ends[2]
        if reached >= depth_m:
            return found
        found.append(index)


def is_free(number: int, hits: Mapping[int, int], passes: Mapping[int, int]) -> bool:
    """Whether what was measured there counts for nothing. One more block than there was is allowed for: of few, in a
    cell's corner, no share can be told."""
    return passes.get(number, 0) > FREE * (hits.get(number, 0) + 1)


# --- sums over keyframes ---

STARTS = 4  # of each origin
SUMS = 4  # keyframes that neighbours can have added and taken out in one step
ALONE_COS = 0.7  # of a block without neighbours that tell how its surface lies
Start = tuple[str, int]  # origin, incarnation
Key = tuple[str, int, int]  # and number
Dose = tuple[tuple[int, int], ...]  # cells and what is added to them


class Landed(NamedTuple):
    """A block whose depth counts."""

    number: int  # of the cell
    weight: int  # information


class Held(NamedTuple):
    frame: Frame
    vouched: bool  # its origin said it, or signed it
    signature: bytes


class CoverageMap(Revertible):
    """Of one robot, between steps."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.held: dict[Start, dict[int, Held]] = {}  # by number
        self.leaving: deque[dict[int, Held]] = deque()  # of starts that gave way: in the sums still, and held no more
        self.cells: dict[int, int] = {}  # information, ONE per mm^2
        self.hits: dict[int, int] = {}  # blocks that end in each cell
        self.passes: dict[int, int] = {}  # and that look through it
        self.version = 0  # counts changes
        self.sums = 0  # keyframes added and taken out since `let_go`
        self._vouched: set[Start] = set()  # starts of which the origin itself said something
        self._share: tuple[int, float] | None = None  # of which version, and what it is
        self._digest: tuple[int, str] | None = None
        self._solid: tuple[int, frozenset[int]] | None = None

    def add(self, frame: Frame, vouched: bool = True, signature: bytes = b"") -> bool:
        """Take a keyframe in whose content was found to be possible; returns whether it changes the map. vouched: its
        origin says it, or has signed it."""
        start, held = (frame.origin, frame.incarnation), Held(frame, vouched, signature)
        if start not in self.held and not self._makes_room(start, vouched):
            return False
        frames = self.held.setdefault(start, {})
        if vouched:
            self._vouched.add(start)
        before = frames.get(frame.number)
        if before is not None and before.frame == frame:
            frames[frame.number] = held if vouched else before
            return False
        if before is not None and not _goes_before(held, before):
            return False
        if before is not None:
            self._sum(before.frame, -1)
        frames[frame.number] = held
        self._sum(frame, 1)
        return True

    def has(self, frame: Frame) -> bool:
        """Whether a keyframe of this origin, start and number is held."""
        return frame.number in self.held.get((frame.origin, frame.incarnation), ())

    def let_go(self, most: int | None = None) -> None:
        """Take keyframes of starts that gave way out of the sums, so many at most; None: all of them."""
        left = sum(map(len, self.leaving)) if most is None else most
        while self.leaving and left > 0:
            frames, left = self.leaving[0], left - 1
            _, held = frames.popitem()
            self._sum(held.frame, -1)
            if not frames:
                self.leaving.popleft()
        self.sums = 0

    def all_keys(self) -> list[Key]:
        """Of all keyframes that are held, in order."""
        return [(*start, number) for start in sorted(self.held) for number in sorted(self.held[start])]

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
            keys = ", ".join(
                f"{start}{number})"
                for (origin, incarnation), frames in sorted(self.held.items())
                for start in (f"('{origin}', {incarnation}, ",)
                for number in sorted(frames)
            )
            self._digest = self.version, hashlib.sha256(self.as_bytes() + f"[{keys}]".encode()).hexdigest()[:16]
        return self._digest[1]

    def _makes_room(self, start: Start, vouched: bool) -> bool:
        """Whether a start is held from now on, where need be in the place of the one that counts least."""
        known = [each for each in self.held if each[0] == start[0]]
        if len(known) < STARTS:
            return True
        least = min(known, key=self._rank)
        if not vouched or self._rank(least) > (True, start[1]):
            return False
        self.leaving.append(self.held.pop(least))
        self._vouched.discard(least)
        self.version += 1
        return True

    def _rank(self, start: Start) -> tuple[bool, int]:
        return start in self._vouched, start[1]

    def _sum(self, frame: Frame, sign: int) -> None:
        self.version, self.sums = self.version + 1, self.sums + 1
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


def _goes_before(one: Held, other: Held) -> bool:
    """Whether the first of two different keyframes under one key counts, where the other is held."""
    if not one.vouched or not other.vouched:
        return one.vouched
    return msgspec.msgpack.encode(one.frame) < msgspec.msgpack.encode(other.frame)


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
