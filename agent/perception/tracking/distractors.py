"""Distractors: things that look like the one that is followed, and are not it.

While a thing is followed, what looks like it near by is not it, and when it is lost, neither is whatever else in that
frame looks like it: it was too far away. These look-alikes are followed, roughly, from frame to frame, each from where
it was in the frame before to one place at most; what comes up where none of them can be may be the thing itself.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from agent.perception.tracking.appearance import Box, common_px, same

# --- where a thing can be in the next frame, and how far it can have gone unseen ---

FRESH = 0.3  # weight of the newest step in the speed
MAX_STEP = 0.5  # of the sides: its middle stays in the box in which it was expected; turning goldfish have 0.25
FIRST_REACH = 0.6  # of the diagonal: how far from there something lost may be in the next frame
MAX_GROWTH = 1.5  # of the area, from frame to frame
MOTION_SPREAD = 0.25  # of the diagonal: by so much more for each frame in which it was not seen
COASTS = 5  # frames for which an unseen thing is expected to keep its speed


class Motion(NamedTuple):
    """A thing that goes on as it went: constant speed, in frames because frames are all that a follower gets."""

    box: Box  # where it was last seen
    step_px: tuple[float, float] = (0.0, 0.0)  # across, down, from frame to frame
    unseen: int = 0  # frames

    def seen(self, box: Box, fresh: float = FRESH) -> Motion:
        """It is in this box now; its newest step has the weight `fresh`."""
        steps = [
            (now - before) / (self.unseen + 1) for now, before in zip(box.centre_px, self.box.centre_px, strict=True)
        ]
        across, down = (fresh * new + (1.0 - fresh) * old for new, old in zip(steps, self.step_px, strict=True))
        return Motion(box, (across, down))

    def missed(self) -> Motion:
        """It is not seen in this frame."""
        return self._replace(unseen=self.unseen + 1)

    @property
    def expected(self) -> Box:
        """Where it should be in the next frame."""
        frames = min(self.unseen + 1, COASTS)
        return self.box.moved(self.step_px[0] * frames, self.step_px[1] * frames)

    @property
    def reach_px(self) -> float:
        """How far from there its middle can be."""
        diagonal = math.hypot(self.box.width, self.box.height)
        return (FIRST_REACH + MOTION_SPREAD * self.unseen) * diagonal + math.hypot(*self.step_px) * self.unseen

    def reaches(self, box: Box) -> bool:
        return math.dist(self.expected.centre_px, box.centre_px) <= self.reach_px

    def allows(self, box: Box) -> bool:
        """Whether one and the same thing can have this box in the next frame."""
        growth = box.area_px / self.box.area_px
        across, down = (now - then for now, then in zip(box.centre_px, self.expected.centre_px, strict=True))
        stays = abs(across) <= MAX_STEP * self.box.width and abs(down) <= MAX_STEP * self.box.height
        return 1.0 / MAX_GROWTH <= growth <= MAX_GROWTH and stays


# --- look-alikes ---

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
    """Those of the places in which no look-alike can be.

    Each look-alike is in the place that is nearest to where it is expected; one that is in none can be in every place
    that it reaches.
    """
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
    """The look-alike that went out of sight where this box is: in the picture they are one.

    Only one whose likeness to the thing was at least `least` can be mistaken for it.
    """
    gone = (other for other in others if other.motion.unseen and other.seen >= CERTAIN and other.like >= least)
    return next((other for other in gone if same(other.motion.box, box)), None)


def touched(others: Sequence[LookAlike], box: Box) -> bool:
    """Whether a part of one of them can be in this box."""
    return any(common_px(other.motion.box, box) for other in others)


# --- occlusion: a thing and a look-alike that have become one in the picture ---
#
# A tracker may leave a meeting with either, or grow over both. What tells them apart is how each moved before: it
# goes on as it went, the more surely the slower it was. Limits were chosen on buoys that pass their double, or turn
# round at it.

TREMBLE = 0.2  # of the diagonal: how far even what stands still is off
TURN = 0.75  # of the way that it would have gone: it may have stopped, or turned
REACH = 4.0  # standard deviations: farther off it is a third one
CLEAR = 4.0  # by so much one reading's squared deviations are less than another's: odds of e to the 2
APART = 30  # frames for which two places have been seen: from then on the better reading is taken, clear or not


class Meeting(NamedTuple):
    """Which place each of the two is in after they were one in the picture."""

    thing: Motion  # as it was before
    other: Motion
    frames: int = 1  # since then
    apart: int = 0  # of these, in which two places were seen

    def next(self, apart: bool) -> Meeting:
        """One frame later, in which two places were seen or one."""
        return self._replace(frames=self.frames + 1, apart=self.apart + apart)

    def reaches(self, box: Box) -> bool:
        """Whether what is in this box can be one of the two."""
        return any(self._off(motion, box) <= REACH**2 for motion in (self.thing, self.other))

    def parted(self, boxes: Sequence[Box]) -> tuple[Box, Box] | None:
        """Where the thing is and where the other is, of places that are like them.

        None where that cannot be told yet: one of the two may be behind the other.
        """
        readings = sorted(
            (self._off(self.thing, mine) + self._off(self.other, its), mine, its)
            for mine, its in itertools.permutations(boxes, 2)
            if not same(mine, its)
        )
        if not readings:
            return None
        best, mine, its = readings[0]
        second = next(off for off, place, _ in readings if place != mine)  # there is one: the two swapped
        return (mine, its) if second - best >= CLEAR or self.apart >= APART else None

    def _off(self, motion: Motion, box: Box) -> float:
        """Squared, in standard deviations, from where it would be by now."""
        frames = self.frames + motion.unseen
        way = motion.step_px[0] * frames, motion.step_px[1] * frames
        sigma_px = TREMBLE * math.hypot(motion.box.width, motion.box.height) + TURN * math.hypot(*way)
        return (math.dist(motion.box.moved(*way).centre_px, box.centre_px) / sigma_px) ** 2


# --- clutter: what a place has to surpass to be taken for a thing that was lost ---
#
# A likeness of 0.7 is proof of a buoy in open water, and none of a fish in a tank where others and the gravel reach
# it time and again. So the limit is the scene's own, as in a radar that keeps its rate of false alarms constant (CFAR):
# places that were like the thing and were not it, because it was seen elsewhere or could not have got there, are
# samples of what chance offers. One of them that is still at its place does not count, however like the thing: it is
# known what that is.

EVERY = 15  # frames from one survey to the next: half a second
CLUTTER_KEPT = 8  # surveys that are remembered: 4 s
FADED = 0.1  # by so much less like the thing one that is still there may be


class Surveys:
    """Clutter: what was like the thing and was not it, in the newest frames in which the whole picture was searched."""

    def __init__(self) -> None:
        self._kept: deque[tuple[int, list[Seen]]] = deque(maxlen=CLUTTER_KEPT)

    def due(self, frame: int) -> bool:
        return not self._kept or frame - self._kept[-1][0] >= EVERY

    def add(self, frame: int, places: Sequence[Seen]) -> None:
        self._kept.append((frame, [*places]))

    @property
    def empty(self) -> bool:
        """Whether none of them found anything like it."""
        return not any(places for _, places in self._kept)

    def clear(self) -> None:
        self._kept.clear()

    def surpass(self, frame: int, places: Sequence[Seen]) -> float:
        """The most like the thing that any of them was that is at none of these places now; 0 where all are."""
        return max((unaccounted(then, places, frame - at) for at, then in self._kept), default=0.0)


def unaccounted(survey: Sequence[Seen], places: Sequence[Seen], frames: int) -> float:
    """The same for one survey, of so many frames ago."""
    others = [LookAlike(Motion(place.box, unseen=frames), place.like) for place in survey]
    found = matched(others, places)
    here = {k for k, n in found.items() if places[n].like >= others[k].like - FADED}
    return max((other.like for k, other in enumerate(others) if k not in here), default=0.0)
