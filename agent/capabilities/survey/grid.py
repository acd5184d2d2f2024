"""The tank cut into cells, each with a number of its own, and which of them somebody wants to see."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from agent.core.config import Coverage, Face, Fleet
from agent.core.messages import Vector

ONE = 1_000_000  # of information: 1 / mm^2
NEAREST_M, FARTHEST_M = 0.12, 1.5  # depths that count
STEEPEST = 0.15  # cosine between a surface's normal and the ray: what is more aslant does not count
FLOOR_MM = 2.0  # standard deviation that nobody's block is better than, whatever it says
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
    """Of a fleet with [coverage]."""
    assert fleet.coverage is not None
    length, breadth, _ = fleet.tank.size_m
    size_m = length, breadth, fleet.tank.surface_m
    cell_m = fleet.coverage.cell_mm * 1e-3
    x, y, z = (max(-_floor(-side / cell_m), 1) for side in size_m)
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
