"""A pose filter whose events come late and out of order: each is put where it belongs, and all that follows is done
again. So the order in which events arrive does not count, to the bit.

A fix belongs to the exposure of its frame, which is up to a few tenths of a second ago when it is known; a force to the
moment when it was sent. What is older than the ring is dropped and counted. Beliefs are kept for longer than that: the
sharpest frame of a sweep may be its first.

Where a target was measured amid a sweep, fixes after it tell better where the robot was then: `Smoother`.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from itertools import islice
from typing import Literal, NamedTuple

from agent.capabilities.swim.pose_filter import (
    Basin,
    Belief,
    Drift,
    Hull,
    Wrench,
    add_fix,
    add_flow,
    add_rate,
    add_sighting,
    ask,
    keep_key,
    kept_in,
    predict,
    target_of,
)
from agent.core.messages import Symmetric, Vector
from agent.core.step_transaction import Revertible

RING_NS = 800_000_000  # ten frames' worth of vision and a busy computer
KEEP_NS = 6_000_000_000  # as long as telemetry is kept (core/attitude.py)
LOG_NS = 5_600_000_000  # a sweep of 4 s, whose sharpest frame may be its first, and the fixes after it

Kind = Literal["1 asked", "2 fix", "3 flow", "4 key", "5 rate", "6 sighting"]  # of one moment, in this order


class Event(NamedTuple):
    """What changes the belief; events of one moment are taken in the order of kinds, then of their numbers."""

    t_ns: int
    kind: Kind
    since_ns: int  # of a flow, the exposure of its key frame; else 0
    values: tuple[float, ...]


def asked(t_ns: int, wrench: Wrench) -> Event:
    """A force was sent (N, N, N m); zeros while motors may not turn."""
    return Event(t_ns, "1 asked", 0, wrench)


def fix(t_ns: int, pose: Vector, fluctuates: Symmetric, stays: Symmetric, agreeing: int = 1) -> Event:
    """Tags put the robot there (TagFix); agreeing: how many of them say the same."""
    return Event(t_ns, "2 fix", 0, (*pose, *fluctuates, *stays, agreeing))


def flow(t_ns: int, since_ns: int, moved: Vector, covariance: Symmetric) -> Event:
    """Odometry since a key frame (plane_odometry.Moved)."""
    return Event(t_ns, "3 flow", since_ns, (*moved, *covariance))


def rate(t_ns: int, rate_rad_s: float) -> Event:
    """A gyro's yaw rate; only of a filter that began with one."""
    return Event(t_ns, "5 rate", 0, (rate_rad_s,))


def sighting(t_ns: int, offset_m: Vector, noise_m2: Symmetric) -> Event:
    """A target at rest was seen there (pose_filter.add_sighting)."""
    return Event(t_ns, "6 sighting", 0, (*offset_m, *noise_m2))


class EventRing(Revertible):
    """The beliefs of one robot about itself over the last seconds.

    What follows a late event is done again when it is asked for, so that several that come together, a fix and the
    flow of its frame, cost one pass.
    """

    def __init__(self, begun: Belief, hull: Hull, drift: Drift, within: Basin | None = None) -> None:
        """begun: the belief at the first fix; what happened before it does not count. within: the walls that it does
        not get beyond, if they are known."""
        self._hull, self._drift, self._within = hull, drift, within
        self._settled: deque[Belief] = deque([begun])  # nothing comes before the newest of these any more
        self._events: list[Event] = []
        self._beliefs: list[Belief] = []  # after each of the first events; those of the others are due
        self._predicted = begun, begun  # the newest prediction: from which belief, and what came of it
        self.dropped = 0  # events that came too late

    @property
    def newest(self) -> Belief:
        return self._after(len(self._events))

    @property
    def newest_ns(self) -> int:
        """When something last happened."""
        return self._events[-1].t_ns if self._events else self._settled[-1].t_ns

    @property
    def events(self) -> tuple[Event, ...]:
        """Those that may still be followed by earlier ones."""
        return tuple(self._events)

    def add(self, event: Event) -> bool:
        """Take in an event, whatever came before; False: it came too late. A flow brings the key frame that it is
        measured from."""
        if event.t_ns <= self._settled[-1].t_ns:
            self.dropped += 1
            return False
        if event.kind == "3 flow":
            key = Event(event.since_ns, "4 key", 0, ())
            if key.t_ns > self._settled[-1].t_ns and key not in self._events:
                self._insert(key)
        self._insert(event)
        return True

    def advance(self, now_ns: int) -> None:
        """Let go of what is so old that nothing may come before it."""
        n = bisect_right(self._events, now_ns - RING_NS, key=_time)
        self._after(n)
        self._settled.extend(self._beliefs[:n])
        del self._events[:n], self._beliefs[:n]
        if not self._events and self._settled[-1].t_ns < now_ns - 2 * RING_NS:
            # Nothing happens any more: each answer would go all the way from the last event, longer and longer.
            self._settled.append(self._predict(self._settled[-1], now_ns - RING_NS))
        while len(self._settled) > 1 and self._settled[1].t_ns <= now_ns - KEEP_NS:
            self._settled.popleft()

    def at(self, t_ns: int) -> Belief | None:
        """The belief at a time: after all that is known of the time before it. None of times that were let go."""
        n = bisect_right(self._events, t_ns, key=_time)
        if n:
            return self._predict(self._after(n), t_ns)
        n = bisect_right(self._settled, t_ns, key=_time)
        return self._predict(self._settled[n - 1], t_ns) if n else None

    def _insert(self, event: Event) -> None:
        """Put an event where it belongs; what was believed from there on no longer counts."""
        place = bisect_right(self._events, event)
        self._events.insert(place, event)
        del self._beliefs[place:]

    def _after(self, n: int) -> Belief:
        """The belief after the first n events."""
        belief = self._beliefs[-1] if self._beliefs else self._settled[-1]
        for event in islice(self._events, len(self._beliefs), n):
            belief = _apply(self._predict(belief, event.t_ns), self._hull, event)
            self._beliefs.append(belief)
        return self._beliefs[n - 1] if n else self._settled[-1]

    def _predict(self, belief: Belief, t_ns: int) -> Belief:
        """What comes of a belief until then. One step asks for the same moment several times, and then sends a force at
        that moment."""
        before, after = self._predicted
        if before is not belief or after.t_ns != t_ns:
            after = predict(belief, self._hull, self._drift, t_ns)
            if self._within is not None and after is not belief:
                after = kept_in(after, self._within)
            self._predicted = belief, after
        return after


class Seen(NamedTuple):
    """A target at rest, measured from the robot: what the robot's own pose has wrong is not in it."""

    target: str
    t_ns: int  # of exposure
    offset_m: Vector  # ahead, to the left, and its height in the world
    random_m2: Symmetric  # averages out over sightings; world axes
    alike_m2: Symmetric  # does not


def offset_m(from_pose: Vector, place_m: Vector) -> Vector:
    """Of a place in the world, as Seen has it. from_pose: x, y, yaw."""
    east, north = place_m[0] - from_pose[0], place_m[1] - from_pose[1]
    c, s = math.cos(from_pose[2]), math.sin(from_pose[2])
    return c * east + s * north, c * north - s * east, place_m[2]


class Smoother(Revertible):
    """What happened in the last seconds, to go through it once more with a sighting (a fixed-lag smoother)."""

    def __init__(self, hull: Hull, within: Basin | None = None) -> None:
        """within: the walls that the robot does not get beyond, if they are known."""
        self._hull, self._within = hull, within
        self._log: deque[Event] = deque()

    def reset(self) -> None:
        """The filter began anew."""
        self._log.clear()

    def add(self, event: Event) -> None:
        """What the filter was told."""
        self._log.append(event)

    def advance(self, now_ns: int) -> None:
        """Let go of what is old."""
        while self._log and self._log[0].t_ns < now_ns - LOG_NS:
            self._log.popleft()

    def place(self, seen: Seen, before: Belief) -> tuple[Vector, Symmetric] | None:
        """The target's place and its covariance, m and m^2, by all that happened until now. before: the filter's belief
        just before the sighting. None: nothing better is known."""
        ring = EventRing(before, self._hull, Drift(), self._within)
        for each in sorted((*self._log, sighting(seen.t_ns, seen.offset_m, seen.random_m2))):
            if each.t_ns > before.t_ns:
                ring.add(each)
        belief = ring.newest
        return target_of(belief) if belief.has_target else None


def _time(of: Event | Belief) -> int:
    return of.t_ns


def _apply(belief: Belief, hull: Hull, event: Event) -> Belief:
    v = event.values
    match event.kind:
        case "1 asked":
            return ask(belief, hull, (v[0], v[1], v[2]))
        case "2 fix":
            fluctuates, stays = (v[3], v[4], v[5], v[6], v[7], v[8]), (v[9], v[10], v[11], v[12], v[13], v[14])
            return add_fix(belief, (v[0], v[1], v[2]), fluctuates, stays, int(v[15]))
        case "3 flow":
            return add_flow(belief, event.since_ns, (v[0], v[1], v[2]), (v[3], v[4], v[5], v[6], v[7], v[8]))
        case "4 key":
            return keep_key(belief)
        case "5 rate":
            return add_rate(belief, v[0])
        case "6 sighting":
            return add_sighting(belief, (v[0], v[1], v[2]), (v[3], v[4], v[5], v[6], v[7], v[8]))
