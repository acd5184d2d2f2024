"""Things that are like the one that is followed, and are not it: each goes on from where one was in the frame before.

While a thing is followed, what looks like it near by is not it, and when it is lost, neither is whatever else in that
frame looks like it: it was too far away. These others are followed, roughly, from frame to frame, each to one place at
most; what comes up where none of them can be may be the thing itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.perception.tracking.box import Box, common_px, same
from agent.perception.tracking.motion import Motion

STEP = 0.5  # of the diagonal: how far one is from where it is expected
SPREAD = 0.1  # of the diagonal, for each frame in which it did not show
KEPT = 30  # frames for which one that does not show is remembered: 1 s
SLOW = 0.1  # weight of the newest frame in its speed and likeness: it is followed roughly, and turns slowly
CERTAIN = 3  # frames for which one has been seen before the thing can be said to have met it
BETTER = 0.2  # a place that is by so much more like the thing than one has been is not that one


class Seen(NamedTuple):
    """A place that is somewhat like the thing."""

    box: Box
    like: float  # the weaker witness, 0 to 1


class LookAlike(NamedTuple):
    motion: Motion
    like: float  # to the thing, lately
    seen: int = 1  # frames

    def off(self, place: Seen) -> float:
        """How far from where it is expected, in units of how far it can be; at most 1 where it can be this place."""
        if place.like > self.like + BETTER:
            return math.inf
        reach = (STEP + SPREAD * self.motion.unseen) * math.hypot(self.motion.box.width, self.motion.box.height)
        return math.dist(self.motion.expected.centre_px, place.box.centre_px) / reach

    def at(self, place: Seen) -> LookAlike:
        like = max(place.like, self.like + SLOW * (place.like - self.like))  # it may turn to look like the thing
        return LookAlike(self.motion.seen(place.box, SLOW), like, self.seen + 1)


def beginning(place: Seen, seen: int = 1) -> LookAlike:
    return LookAlike(Motion(place.box), place.like, seen)


def matched(others: Sequence[LookAlike], places: Sequence[Seen]) -> dict[int, int]:
    """Which of the places each of them has now, by their numbers; the nearest first, none twice."""
    pairs = sorted((other.off(place), k, n) for k, other in enumerate(others) for n, place in enumerate(places))
    found: dict[int, int] = {}
    for off, k, n in pairs:
        if off <= 1.0 and k not in found and n not in found.values():
            found[k] = n
    return found


def unexplained(others: Sequence[LookAlike], places: Sequence[Seen]) -> list[Box]:
    """Those of the places in which none of them can be: each is in the one that is nearest to where it is expected, and
    one that is in none of them can be in every one that it reaches."""
    found = matched(others, places)
    hidden = [other for k, other in enumerate(others) if k not in found]
    taken = {*found.values()}
    return [
        place.box
        for n, place in enumerate(places)
        if n not in taken
        and not any(other.off(place) <= 1.0 for other in hidden)
        and not any(same(place.box, places[k].box) for k in taken)
    ]


def followed(others: Sequence[LookAlike], places: Sequence[Seen]) -> list[LookAlike]:
    """The same ones in the next frame, in which `places` are like the thing and are not it."""
    found = matched(others, places)
    seen = [others[k].at(places[n]) for k, n in found.items()]
    new = [beginning(place) for n, place in enumerate(places) if n not in found.values()]
    missing = [other._replace(motion=other.motion.missed()) for k, other in enumerate(others) if k not in found]
    return seen + new + [other for other in missing if other.motion.unseen <= KEPT]


def merged(others: Sequence[LookAlike], box: Box, least: float) -> LookAlike | None:
    """The one of them that went out of sight where this box is: in the picture they are one. Only one that was at
    `least` so like the thing can be mistaken for it."""
    gone = (other for other in others if other.motion.unseen and other.seen >= CERTAIN and other.like >= least)
    return next((other for other in gone if same(other.motion.box, box)), None)


def touched(others: Sequence[LookAlike], box: Box) -> bool:
    """Whether a part of one of them can be in this box."""
    return any(common_px(other.motion.box, box) for other in others)
