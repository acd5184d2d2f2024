"""The aided pose: where a robot is by its own filter and by a target that others have located.

A second filter has all that the own one has, and the place of a target at rest in its state, by this robot's own
sightings alone. What the others say of that place, (x, C) with nothing of this robot in it, is not told to the filter
but compared with it whenever the aided pose is asked for:

    S = P_tt + C + D + J B J' ;  K = P_xt S^-1 ;  x += K (x_others - x_t) ;  P -= K S K'

P_tt, P_xt: of the target, and of the state with it; D: what this robot's sightings have wrong alike (range, level);
B: what its fixes have wrong alike; J = [e_x, e_y, e_z x arm]. So the others' error, the same at every sighting, is
counted once however often the target is seen, and a better word of theirs replaces the one before. B is considered and
not reduced (a Schmidt filter's way: Schmidt 1966): `stays` of the outcome is that of the own pose.

The own filter, and with it all that a robot says, never learns of this.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

from agent.capabilities.swim.event_ring import RING_NS, Event, EventRing, sighting
from agent.capabilities.swim.pose_filter import GATE, Basin, Belief, Drift, Hull
from agent.core.estimation.interface import Posterior
from agent.core.linear_algebra import apply, dot, inverse, plus, quadratic, wrap
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.fix import carried
from agent.core.step_transaction import Revertible

NEED_M = 0.02  # one sigma of place: a robot that sees tags between its sweeps knows better by itself
LATE_NS = 4_000_000_000  # the sharpest frame of a sweep may be its first
LOG_NS = LATE_NS + 2 * RING_NS


class Seen(NamedTuple):
    """A target at rest, measured from the robot: what the robot's own pose has wrong is not in it."""

    target: str
    t_ns: int  # of exposure
    offset_m: Vector  # ahead, to the left, and its height in the world
    random_m2: Symmetric  # averages out over sightings; world axes
    alike_m2: Symmetric  # does not


class Aid(Revertible):
    """Of one robot, by one target at a time. The filter runs while it is needed, else only what happens is kept."""

    def __init__(self, hull: Hull, within: Basin | None = None) -> None:
        """within: the walls that the robot does not get beyond, if they are known."""
        self._hull, self._within = hull, within
        self._log: deque[Event] = deque()  # what the own filter was told in the last seconds
        self._seen: deque[Seen] = deque()  # of the target, in the last seconds; the newest always
        self._ring: EventRing | None = None

    @property
    def target(self) -> str | None:
        """The one that it may be aided by."""
        return self._seen[-1].target if self._seen else None

    def reset(self) -> None:
        """The own filter began anew."""
        self._log.clear()
        self._forget()

    def add(self, event: Event) -> None:
        """What the own filter was told."""
        self._log.append(event)
        if self._ring is not None:
            self._ring.add(event)

    def advance(self, now_ns: int) -> None:
        """Let go of what is old."""
        while self._log and self._log[0].t_ns < now_ns - LOG_NS:
            self._log.popleft()
        while len(self._seen) > 1 and self._seen[0].t_ns < now_ns - LATE_NS:
            self._seen.popleft()
        if self._ring is not None:
            self._ring.advance(now_ns)

    def see(self, seen: Seen) -> None:
        """A sighting."""
        if seen.target != self.target:
            self._forget()
        self._seen.append(seen)
        if self._ring is not None:
            self._ring.add(_event(seen))

    def needed(self, own: Belief, others: Posterior | None) -> bool:
        """Whether the filter is to `begin`: the own one is less sure of its place than it has to be and than a sighting
        makes it. own: now; others: what they say of `target`, nothing of this robot in it; None: nothing."""
        if others is None or not self._seen or self._seen[-1].t_ns < own.t_ns - LATE_NS:
            return False
        newest, spread_m2 = self._seen[-1], _spread_m2(own.covariance)
        by_sight = plus(plus(others.cov_m2, newest.alike_m2), newest.random_m2)
        return self._ring is None and spread_m2 > max(NEED_M * NEED_M, _spread_m2(by_sight))

    def begins_ns(self, now_ns: int) -> int:
        """Before all sightings that are kept, and before all that may still come."""
        return min(self._seen[0].t_ns, now_ns - RING_NS) - 1

    def begin(self, settled: Belief) -> None:
        """Run from that belief of the own filter on: it is of begins_ns()."""
        self._ring = self._run(settled, self._seen)

    def at(self, own: Belief, others: Posterior | None) -> Belief | None:
        """The aided pose at the time of the own one; None where there is none, or the own one needs no aid any more."""
        if others is None:  # the target has moved, or no other robot sees it
            self._forget()
        if self._ring is None or others is None:
            return None
        least_m2 = max(0.25 * NEED_M * NEED_M, _spread_m2(plus(others.cov_m2, self._seen[-1].alike_m2)))
        if _spread_m2(own.covariance) < least_m2:
            self._ring = None
            return None
        believed = self._ring.at(own.t_ns)
        return None if believed is None else aided(believed, others, self._seen[-1].alike_m2)

    def smoothed(self, seen: Seen, before: Belief) -> tuple[Vector, Symmetric] | None:
        """The target's place and its covariance, m and m^2, by all that happened until now: later fixes tell where the
        robot was at the sighting. before: the own filter's belief just before it. None: nothing better is known."""
        belief = self._run(before, (seen,)).newest
        if not belief.has_target:
            return None
        place, spread_m2, _ = _target(belief)
        return place, spread_m2

    def _run(self, settled: Belief, sightings: Iterable[Seen]) -> EventRing:
        """A filter with these sightings and all that the own one was told after that belief."""
        ring = EventRing(settled, self._hull, Drift(), LATE_NS, self._within)
        for each in sorted((*self._log, *map(_event, sightings))):
            if each.t_ns > settled.t_ns:
                ring.add(each)
        return ring

    def _forget(self) -> None:
        self._seen.clear()
        self._ring = None


def aided(believed: Belief, others: Posterior, alike_m2: Symmetric) -> Belief | None:
    """The state without the target, given that others put that there: one chance in a thousand of honest words is
    refused (None). alike_m2: of the robot's sightings, what is wrong in all of them."""
    if not believed.has_target:
        return None
    P, ((x, y, z), spread, n) = believed.P, _target(believed)
    arm_m = x - believed.x[0], y - believed.x[1], 0.0
    S = plus(plus(plus(spread, others.cov_m2), alike_m2), carried(arm_m, believed.stays))
    precision, miss_m = inverse(S), (others.x_m[0] - x, others.x_m[1] - y, others.x_m[2] - z)
    if precision is None or quadratic(precision, miss_m) > GATE:
        return None
    step = apply(precision, miss_m)
    cross = [(row[n], row[n + 1], row[n + 2]) for row in P[:n]]
    gains = [apply(precision, row) for row in cross]
    moved = [a + dot(row, step) for a, row in zip(believed.x, cross, strict=False)]
    moved[2] = wrap(moved[2])
    rows = tuple(
        tuple(P[i][j] - dot(gains[min(i, j)], cross[max(i, j)]) for j in range(n)) for i in range(n)
    )  # symmetric to the bit
    return believed._replace(x=tuple(moved), P=rows, key_ns=None, has_target=False)


def offset_m(from_pose: Vector, place_m: Vector) -> Vector:
    """Of a place in the world, as Seen has it. from_pose: x, y, yaw."""
    east, north = place_m[0] - from_pose[0], place_m[1] - from_pose[1]
    c, s = math.cos(from_pose[2]), math.sin(from_pose[2])
    return c * east + s * north, c * north - s * east, place_m[2]


def _target(belief: Belief) -> tuple[Vector, Symmetric, int]:
    """Its place in the state, the covariance of that, and where in the state it is."""
    n, P = len(belief.x) - (6 if belief.key_ns is not None else 3), belief.P
    spread = P[n][n], P[n][n + 1], P[n][n + 2], P[n + 1][n + 1], P[n + 1][n + 2], P[n + 2][n + 2]
    return (belief.x[n], belief.x[n + 1], belief.x[n + 2]), spread, n


def _event(seen: Seen) -> Event:
    return sighting(seen.t_ns, seen.offset_m, seen.random_m2)


def _spread_m2(covariance: Symmetric) -> float:
    """Along x and y together; of a place or of a pose."""
    return covariance[0] + covariance[3]
