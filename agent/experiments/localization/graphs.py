"""Who hears whom: the communication graphs of the experiments, as neighbours by number."""

from __future__ import annotations

import math
from random import Random
from typing import Literal

import numpy as np
from numpy.typing import NDArray

Graph = tuple[tuple[int, ...], ...]  # neighbours of each robot, ascending, never itself
Matrix = NDArray[np.float64]
Topology = Literal["full", "ring", "line", "geometric"]

GEOMETRIC_SEED = 7  # ten robots come out hard to serve: 11 links, three dead ends, six hops from end to end
DRAWS = 1000  # until a connected graph is found; at the radius below one in a few is


def graph(topology: Topology, robots: int) -> Graph:
    """The graph of this name. `geometric` is one fixed draw for each number of robots."""
    if topology == "geometric":
        return geometric(robots, GEOMETRIC_SEED)
    linked = np.zeros((robots, robots), dtype=bool)
    for i in range(robots):
        for j in range(robots):
            apart = abs(i - j)
            linked[i, j] = {
                "full": apart > 0,
                "line": apart == 1,
                "ring": apart in (1, robots - 1),
            }[topology]
    return _neighbours(linked)


def geometric(robots: int, seed: int) -> Graph:
    """Robots anywhere in a square, linked when near: the first connected draw of the seeds from `seed` on.

    The radius sqrt(2 ln N / (pi N)) of the unit square is sqrt(2) times that at which large graphs become connected
    (Gupta and Kumar, 1998).
    """
    radius = math.sqrt(2.0 * math.log(robots) / (math.pi * robots))
    for attempt in range(seed, seed + DRAWS):
        random = Random(attempt)
        place = np.array([[random.random(), random.random()] for _ in range(robots)])
        linked = np.linalg.norm(place[:, None] - place[None], axis=2) < radius
        np.fill_diagonal(linked, False)
        found = _neighbours(linked)
        if diameter(found) < math.inf:
            return found
    raise ValueError(f"no connected geometric graph of {robots} robots in {DRAWS} draws")


def diameter(neighbours: Graph) -> float:
    """Longest shortest path in hops; infinite when not connected."""
    longest = 0.0
    for start in range(len(neighbours)):
        hops, edge = {start: 0}, [start]
        while edge:
            edge = [j for i in edge for j in neighbours[i] if hops.setdefault(j, hops[i] + 1) == hops[i] + 1]
            edge = list(dict.fromkeys(edge))
        if len(hops) < len(neighbours):
            return math.inf
        longest = max(longest, *hops.values())
    return longest


def paper_weights(neighbours: Graph) -> Matrix:
    """W of equation (ac) when all see: 1 / |N_i| for each neighbour, nothing for the robot itself; (N, N)."""
    W = np.zeros((len(neighbours), len(neighbours)))
    for i, near in enumerate(neighbours):
        W[i, list(near)] = 1.0 / len(near)
    return W


def metropolis_weights(neighbours: Graph) -> Matrix:
    """W of the Metropolis rule when all see: 1 / (1 + larger degree), the rest to the robot itself; (N, N)."""
    W = np.zeros((len(neighbours), len(neighbours)))
    for i, near in enumerate(neighbours):
        for j in near:
            W[i, j] = 1.0 / (1.0 + max(len(near), len(neighbours[j])))
        W[i, i] = 1.0 - W[i].sum()
    return W


def _neighbours(linked: NDArray[np.bool_]) -> Graph:
    return tuple(tuple(int(j) for j in np.flatnonzero(row)) for row in linked)
