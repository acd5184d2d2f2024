"""Whose lamps burn while robots follow what swims.

A fish is followed by frames, none of which has to be like the one before: a lamp that changes spoils nothing, and no
lease is needed. Where everybody knows where all are and where the target is, each works out the same set of lamps by
itself, and burns or darkens its own: the one by which most followers see the target. For a follower whose light that
comes from the target is a share c of all light it is 0 at c = 0.25, 1 at 0.45, times the share of headings that show
it the lit side of a flat body,

    1 - theta / pi        theta: between camera and the nearest lamp that burns, as the target has them

and nothing at all with a lamp that shines into its camera. The set that burns stays until another shows the target to
more of them, by [lighting] gain, for half a second: what each knows a little otherwise makes no lamp flicker.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from itertools import combinations
from typing import NamedTuple

from agent.capabilities.light.allocate import Scene, dazzles
from agent.capabilities.light.information import worth
from agent.capabilities.light.model import Pair, pair
from agent.core.config import Lighting
from agent.core.messages import Vector

# Of the target's light in all light: by less the twin's fish is in no frame, by more in nearly all that show its side
# (harbour water, world 0, 0.5 to 1.5 m).
FAINT, PLAIN = 0.25, 0.45
MOST = 3  # lamps at once: each more is veil for all
ALIKE = 0.15  # of a follower: what 2 cm in each place make of it
HOLD_NS = 500_000_000


class View(NamedTuple):
    """What lamps do for one follower."""

    scene: Scene
    pairs: Mapping[str, Pair]  # by the lamp's robot
    chances: Mapping[str, float]  # by likewise: that the lit side of the target is on the camera's
    dazzled_by: frozenset[str]


def view(scene: Scene, lamps_m: Mapping[str, Vector], lighting: Lighting) -> View:
    """lamps_m: of all that can burn, by robot; world frame."""
    names = sorted(lamps_m)
    return View(
        scene,
        {name: pair(scene.camera_m, scene.target_m, scene.radius_m, lamps_m[name], lighting) for name in names},
        {name: 1.0 - _angle(scene.target_m, scene.camera_m, lamps_m[name]) / math.pi for name in names},
        frozenset(name for name in names if dazzles(scene, lamps_m[name])),
    )


def followers(views: Iterable[View], lamps: frozenset[str]) -> float:
    """How many see the target by these lamps, of which each view knows, as one expects."""
    number = 0.0
    for each in views if lamps else ():
        if lamps & each.dazzled_by:
            continue
        scene, names = each.scene, sorted(lamps)
        depth_m = math.dist(scene.camera_m, scene.target_m)
        by = worth([each.pairs[name] for name in names], depth_m, scene.radius_m, scene.focal_px, scene.slope_mm)
        plain = min(max((by.contrast - FAINT) / (PLAIN - FAINT), 0.0), 1.0)
        number += plain * max(each.chances[name] for name in names)
    return round(number, 6)  # exp and acos differ between processors in their last bits, a decision must not


def best(views: Iterable[View], names: Iterable[str]) -> tuple[frozenset[str], float]:
    """The set of lamps of these robots by which most followers see the target, and how many do. Of sets that are alike
    the one of fewer lamps, then the one whose names come first: who knows all a little otherwise shall find the same.
    """
    views, ordered = tuple(views), sorted(names)
    sets = [frozenset(some) for size in range(1, MOST + 1) for some in combinations(ordered, size)]
    numbers = [followers(views, some) for some in sets]
    most = max(numbers, default=0.0)
    found = ((some, number) for some, number in zip(sets, numbers, strict=True) if number >= most - ALIKE)
    return next(found, (frozenset[str](), 0.0))


class Held(NamedTuple):
    """Between decisions."""

    lamps: frozenset[str] = frozenset()  # that shall burn
    better_ns: int | None = None  # since when another set would show it to more


def decided(
    held: Held, views: Iterable[View], names: Iterable[str], burning: frozenset[str], gain: float, now_ns: int
) -> Held:
    """burning: of these names, as they say."""
    views = tuple(views)
    found, number = best(views, names)
    if number <= followers(views, burning) + gain:
        return Held(burning)
    since_ns = now_ns if held.better_ns is None else held.better_ns
    return Held(found if now_ns - since_ns >= HOLD_NS else burning, since_ns)


def _angle(at_m: Vector, one_m: Vector, other_m: Vector) -> float:
    """Between two places as seen from a third, rad."""
    a = [p - o for p, o in zip(one_m, at_m, strict=True)]
    b = [p - o for p, o in zip(other_m, at_m, strict=True)]
    size = math.hypot(*a) * math.hypot(*b)
    return math.acos(min(max(sum(p * q for p, q in zip(a, b, strict=True)) / size, -1.0), 1.0)) if size else 0.0
