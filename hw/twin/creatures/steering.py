"""What a creature shies from, and what it cannot swim through."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from agent.core.messages import Vector

SHY_M = 0.35  # from where it minds walls, floor, surface, stones and robots
SIDE, LEVEL = 0.52, 0.31  # lengths that its middle keeps from walls; from floor and surface, whatever its pitch
SKIN = 0.2  # lengths that its middle keeps from the surface of a stone


class Thing(NamedTuple):
    """An upright ellipsoid in the way: a stone, a ball, a robot."""

    centre_m: Vector
    radii_m: Vector


class Water(NamedTuple):
    """The water body from a corner on the floor, and what is in it."""

    size_m: Vector
    stones: Sequence[Thing] = ()
    robots: Sequence[Thing] = ()
    current_m_s: Vector = (0.0, 0.0, 0.0)  # everywhere the same


def pushes(place_m: Vector, length_m: float, water: Water) -> Vector:
    """Where to get away to: each thing within SHY_M pushes straight off by up to 1, with the square of its nearness.

    Of a tank that is narrow the middle third pushes nobody. Robots count from their middle, stones from their surface.
    """
    away = [0.0, 0.0, 0.0]
    for axis, (x, size) in enumerate(zip(place_m, water.size_m, strict=True)):
        margin = margin_m(axis, length_m)
        shy = max(min(SHY_M, size / 3), margin * 1.01)
        for sign, distance in ((1.0, x), (-1.0, size - x)):
            away[axis] += sign * _nearness(distance, margin, shy)
    for things, hulls in ((water.stones, False), (water.robots, True)):
        for thing in things:
            off, distance = _off(place_m, thing.centre_m)
            reach = 0.0 if hulls else _radius_towards(thing, off)
            least = max(thing.radii_m) if hulls else SKIN * length_m
            push = _nearness(distance - reach, least, SHY_M)
            for axis in range(3):
                away[axis] += push * off[axis]
    return away[0], away[1], away[2]


def allowed(place_m: Vector, length_m: float, water: Water) -> Vector:
    """The nearest place that is not in a stone, a robot or a wall."""
    for thing in (*water.stones, *water.robots):
        place_m = _out_of(place_m, thing, SKIN * length_m)
    inside = []
    for axis, (x, size) in enumerate(zip(place_m, water.size_m, strict=True)):
        margin = margin_m(axis, length_m)
        inside.append(min(max(x, margin), size - margin))
    return inside[0], inside[1], inside[2]


def lee(stone: Thing, watcher_m: Vector, length_m: float, water: Water) -> Vector:
    """The place right behind a stone for who watches from there."""
    dx, dy = stone.centre_m[0] - watcher_m[0], stone.centre_m[1] - watcher_m[1]
    far = math.hypot(dx, dy) or 1.0
    ux, uy = dx / far, dy / far
    reach_m = _radius_towards(stone, (ux, uy, 0.0)) + 1.2 * SKIN * length_m
    x, y, z = stone.centre_m
    return allowed((x + ux * reach_m, y + uy * reach_m, z), length_m, water)


def nearest(place_m: Vector, things: Iterable[Thing]) -> Thing | None:
    return min(things, key=lambda thing: math.dist(thing.centre_m, place_m), default=None)


def margin_m(axis: int, length_m: float) -> float:
    """What a creature's middle keeps from either wall, or from floor and surface."""
    return (SIDE if axis < 2 else LEVEL) * length_m


def _nearness(distance_m: float, least_m: float, shy_m: float) -> float:
    share = min(max((shy_m - distance_m) / (shy_m - least_m), 0.0), 1.0)
    return share * share


def _off(place_m: Vector, centre_m: Vector) -> tuple[Vector, float]:
    """The unit vector from a centre to a place, and how far it is."""
    x, y, z = (a - b for a, b in zip(place_m, centre_m, strict=True))
    distance = math.sqrt(x * x + y * y + z * z)
    return ((x / distance, y / distance, z / distance), distance) if distance > 0.0 else ((1.0, 0.0, 0.0), 0.0)


def _radius_towards(thing: Thing, off: Vector) -> float:
    return 1.0 / math.sqrt(sum((u / r) ** 2 for u, r in zip(off, thing.radii_m, strict=True)))


def _out_of(place_m: Vector, thing: Thing, skin_m: float) -> Vector:
    """Straight off the centre to the surface of the thing and its skin, where it is inside of that."""
    grown = Thing(thing.centre_m, (thing.radii_m[0] + skin_m, thing.radii_m[1] + skin_m, thing.radii_m[2] + skin_m))
    off, distance = _off(place_m, thing.centre_m)
    reach = _radius_towards(grown, off)
    if distance >= reach:
        return place_m
    x, y, z = (c + reach * u for c, u in zip(thing.centre_m, off, strict=True))
    return x, y, z
