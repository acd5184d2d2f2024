"""A robot's part of the tank, and lanes through it."""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent.capabilities.swim.barrier import MARGIN_M, WALL_M, Planar

Polygon = tuple[Planar, ...]  # convex, anticlockwise


def cell(here_m: Planar, others_m: Sequence[Planar], tank_m: Planar) -> Polygon:
    """All places where a robot may swim that are nearer to it than to any other; empty where there is none."""
    clear_m = WALL_M + MARGIN_M
    length, breadth = (max(side - clear_m, clear_m) for side in tank_m)
    part: Polygon = ((clear_m, clear_m), (length, clear_m), (length, breadth), (clear_m, breadth))
    for other in others_m:
        x, y = other[0] - here_m[0], other[1] - here_m[1]
        middle = x * (here_m[0] + other[0]) / 2.0 + y * (here_m[1] + other[1]) / 2.0
        part = _cut(part, (x, y), middle)
    return part


def lanes(part: Polygon, lane_m: float, here_m: Planar) -> tuple[Planar, ...]:
    """Ends of lanes along the longer side of a part, in the order in which they are swum, to and fro, from the end
    that is nearest. From a lane somebody sees half of lane_m to either side, and so much beyond its ends."""
    if len(part) < 3:
        return ()
    spans = [max(point[axis] for point in part) - min(point[axis] for point in part) for axis in (0, 1)]
    along = 0 if spans[0] >= spans[1] else 1
    count = max(math.ceil(spans[1 - along] / lane_m), 1)
    first = min(point[1 - along] for point in part)
    found = []
    for k in range(count):
        level = first + (k + 0.5) * spans[1 - along] / count
        low, high = _crossing(part, along, level)
        trim = min(0.5 * lane_m, 0.5 * (high - low))
        found.append((_at(along, low + trim, level), _at(along, high - trim, level)))
    return _to_and_fro(found, here_m)


def _to_and_fro(found: Sequence[tuple[Planar, Planar]], here_m: Planar) -> tuple[Planar, ...]:
    """One lane this way, the next one back; of the four ways to begin that with the nearest end."""
    ways = []
    for ordered in (found, found[::-1]):
        for turned in (0, 1):
            turns = (lane if (k + turned) % 2 == 0 else lane[::-1] for k, lane in enumerate(ordered))
            ways.append([end for lane in turns for end in lane])
    best = min(ways, key=lambda way: math.dist(way[0], here_m))
    return tuple(end for k, end in enumerate(best) if k == 0 or end != best[k - 1])


def _cut(part: Polygon, normal: Planar, most: float) -> Polygon:
    """What of a convex part has normal . p <= most (Sutherland and Hodgman 1974)."""
    kept: list[Planar] = []
    for k, b in enumerate(part):
        a = part[k - 1]
        over_a, over_b = (normal[0] * p[0] + normal[1] * p[1] - most for p in (a, b))
        if over_a * over_b < 0.0:
            share = over_a / (over_a - over_b)
            kept.append((a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1])))
        if over_b <= 0.0:
            kept.append(b)
    return tuple(kept)


def _crossing(part: Polygon, along: int, level: float) -> tuple[float, float]:
    """From where to where a line along an axis is within the part."""
    hits = []
    for k, b in enumerate(part):
        a = part[k - 1]
        low, high = min(a[1 - along], b[1 - along]), max(a[1 - along], b[1 - along])
        if low <= level <= high and high > low:
            share = (level - a[1 - along]) / (b[1 - along] - a[1 - along])
            hits.append(a[along] + share * (b[along] - a[along]))
    return (min(hits), max(hits)) if hits else (part[0][along], part[0][along])


def _at(along: int, far: float, level: float) -> Planar:
    return (far, level) if along == 0 else (level, far)
