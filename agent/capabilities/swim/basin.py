"""Where a robot's centre can be: inside the tank, and no nearer to a wall than its hull lets it.

A pose filter knows forces, not walls: who is pulled against one while no landmark is in sight believes to swim on into
it, ever faster. So a belief whose mean has come beyond a wall is cut off there: of the Gaussian only the part within
counts, and mean and covariance of that part are the belief from then on (Simon and Simon 2010, truncation of the
density). That is done where the mean is beyond and not at every moment: the wall says the same thing each time, and
the same thing counted again and again would make a robot sure that it is nowhere near.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.capabilities.swim.pose_filter import Belief
from agent.core.linear_algebra import wrap

HULL_M = 0.14  # from its centre to a wall that it leans against
FARTHEST = 3.0  # sigmas beyond: what is farther out was believed wrong, and tells nothing of how wrong

Side = tuple[float, float]  # from, to, m


class Basin(NamedTuple):
    """Where the centre may be."""

    x_m: Side
    y_m: Side


def basin(tank_m: Sequence[float]) -> Basin:
    """Of a tank of that length and breadth."""
    length_m, breadth_m = tank_m[:2]
    return Basin((HULL_M, length_m - HULL_M), (HULL_M, breadth_m - HULL_M))


def kept_in(belief: Belief, within: Basin) -> Belief:
    """The belief, cut off at the walls that its mean is beyond."""
    for k, (least_m, most_m) in enumerate(within):
        if belief.x[k] < least_m:
            belief = _cut_off(belief, k, least_m, 1.0)
        elif belief.x[k] > most_m:
            belief = _cut_off(belief, k, most_m, -1.0)
    return belief


def _cut_off(belief: Belief, k: int, wall_m: float, inwards: float) -> Belief:
    """Given that coordinate k is at the wall or on its inner side; inwards: 1 where that is greater, else -1.

    Of a unit Gaussian that part which is more than z has the mean h(z), its hazard, and the variance
    1 + z h - h h. All else of the state follows by how it goes along with that coordinate.
    """
    variance = belief.P[k][k]
    sigma = math.sqrt(variance)
    z = min(inwards * (wall_m - belief.x[k]) / sigma, FARTHEST)
    hazard = math.sqrt(2.0 / math.pi) * math.exp(-0.5 * z * z) / math.erfc(z / math.sqrt(2.0))
    moved_m = wall_m + inwards * sigma * (hazard - z) - belief.x[k]
    lost = hazard * (hazard - z)  # share of the variance
    gain = [row[k] / variance for row in belief.P]
    x = tuple(a + g * moved_m for a, g in zip(belief.x, gain, strict=True))
    P = tuple(
        tuple(p - (g * h) * (lost * variance) for p, h in zip(row, gain, strict=True))
        for row, g in zip(belief.P, gain, strict=True)
    )
    return belief._replace(x=(*x[:2], wrap(x[2]), *x[3:]), P=P)
