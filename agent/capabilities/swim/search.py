"""Search for a target that no robot knows: first around where it was last, then along lanes through the robot's own
part of the tank.

That part is its Voronoi cell among the robots that search with it, drawn in by what is kept clear of walls (Cortes,
Martinez, Karatas and Bullo, Coverage control for mobile sensing networks, IEEE Trans. Robotics and Automation 20(2),
2004). It is cut when the robot begins and again when another begins or falls silent, not while all swim on: lanes that
moved along with all robots would never end. What these robots have passed in this round is not swum again: a link
that drops now and then would have each begin for ever. An end that a robot cannot reach is left out. The camera looks
all around meanwhile (SearchPattern). A robot that has the target in view waits where it is, for a sweep wants a robot
at rest.

`Surroundings` is what Follow and Survey go by as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.capabilities.swim.barrier import MARGIN_M, SPEED_M_S, STILL, WALL_M, Planar, Reference
from agent.core.config import Search
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.core.target_state import TargetEstimate

# --- surroundings ---
# What a behaviour may know beside the robot's pose: the tank, the target that it is about, and which other robots are
# about that target.

SEEN_NS = 20_000_000_000  # a look for landmarks takes seconds, and targets take turns: unseen for longer is unknown
ANYWHERE_M = 0.5  # sigma of a target that no robot sees: too much water to look at from one place
GIMBAL_RAD = math.radians(50.0)  # to either side: beyond, the body turns after the gimbal
# Of a wall ahead: from nearer no whole landmark fits into the picture, or one, and there is little else to go by.
SIGHT_M = 0.8
SPEED_NS = 3_000_000_000  # unseen for so long, a target that moved may have turned


def known(target: TargetEstimate | None, now_ns: int) -> bool:
    """Whether a robot has seen it of late, and it cannot be anywhere by now."""
    if target is None:
        return False
    unseen_ns = now_ns - target.seen_ns
    return unseen_ns <= SPEED_NS or (unseen_ns <= SEEN_NS and target.sigma_m < ANYWHERE_M)


def velocity_m_s(target: TargetEstimate, now_ns: int) -> Planar:
    """Over ground, as long as a robot sees that it still moves so."""
    return (target.v_m_s[0], target.v_m_s[1]) if now_ns - target.seen_ns <= SPEED_NS else STILL


class Surroundings(NamedTuple):
    """At one moment."""

    tank_m: Planar  # length and breadth
    speed_m_s: float = SPEED_M_S  # that the robot may swim at
    velocity_m_s: Planar = STILL  # at which it swims now, world frame
    target: TargetEstimate | None = None  # None: no robot ever said where it is
    swims: bool = False  # the target that it is about, by itself
    sees: bool = False  # the robot's own camera has the target in view
    looks: bool = False  # its gimbal still goes round where the target was last
    fellows_m: tuple[Planar, ...] = ()  # robots that say they do the same about the same target
    screens_m: tuple[Planar, ...] = ()  # what hid the target lately, about there
    robots_m: tuple[Planar, ...] = ()  # all that say where they are
    station: tuple[Planar, float] | None = None  # where a survey looks from, and how it is turned there, rad


def within_walls(place_m: Planar, tank_m: Planar) -> Planar:
    """The nearest place that a robot may be told to swim to."""
    clear_m = WALL_M + MARGIN_M
    x, y = (min(max(at, clear_m), max(side - clear_m, clear_m)) for at, side in zip(place_m, tank_m, strict=True))
    return x, y


def walled_in(place_m: Planar, yaw: float, tank_m: Planar) -> bool:
    """Whether a robot that looks that way from there has a wall before it."""
    return sight_m(place_m, yaw, tank_m) < SIGHT_M


def sight_m(place_m: Planar, yaw: float, tank_m: Planar) -> float:
    """How far it is to the wall, that way from there."""
    ways = zip(place_m, (math.cos(yaw), math.sin(yaw)), tank_m, strict=True)
    return min((side - at if way > 0.0 else at) / abs(way) if way else math.inf for at, way, side in ways)


def facing(yaw: float, bearing: float) -> float:
    """The yaw nearest to the wanted one from which the gimbal reaches what is at that bearing."""
    off = wrap(bearing - yaw)
    return yaw if abs(off) <= GIMBAL_RAD else wrap(bearing - math.copysign(GIMBAL_RAD, off))


# --- cell and lanes ---

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


def lanes(
    part: Polygon, lane_m: float, here_m: Planar, crosswise: bool = False, passed: Squares = frozenset()
) -> tuple[Planar, ...]:
    """Ends of lanes along the longer side of a part, or across it, in the order in which they are swum, to and fro,
    from the end that is nearest. From a lane a robot sees half of lane_m to either side, and so much beyond its ends.
    passed: where robots have looked from already; what they saw of a lane at either end of it is left out.
    """
    if len(part) < 3:
        return ()
    spans = [max(point[axis] for point in part) - min(point[axis] for point in part) for axis in (0, 1)]
    along = 0 if (spans[0] >= spans[1]) != crosswise else 1
    count = max(math.ceil(spans[1 - along] / lane_m), 1)
    first = min(point[1 - along] for point in part)
    found = []
    for k in range(count):
        level = first + (k + 0.5) * spans[1 - along] / count
        low, high = _crossing(part, along, level)
        trim = min(0.5 * lane_m, 0.5 * (high - low))
        found.append((_at(along, low + trim, level), _at(along, high - trim, level)))
    left = [lane for each in found if (lane := _unseen(*each, lane_m, passed)) is not None]
    return _to_and_fro(left, here_m) if left else ()


# A round remembers the squares of water that robots have passed.
Squares = frozenset[tuple[int, int]]
SQUARE = 0.25  # of lane_m
# Squares from which half of lane_m reaches into one.
ABOUT = tuple((i, j) for i in range(-2, 3) for j in range(-2, 3) if math.hypot(i, j) * SQUARE <= 0.5)


def square(place_m: Planar, lane_m: float) -> tuple[int, int]:
    """The one that it is in."""
    side_m = SQUARE * lane_m
    return math.floor(place_m[0] / side_m), math.floor(place_m[1] / side_m)


def _unseen(a: Planar, b: Planar, lane_m: float, passed: Squares) -> tuple[Planar, Planar] | None:
    """What is left of a lane, from the first place to the last that no robot has passed nearby; None: nothing."""
    if not passed:
        return a, b
    count = max(math.ceil(math.dist(a, b) / (SQUARE * lane_m)), 1)
    places = [(a[0] + k / count * (b[0] - a[0]), a[1] + k / count * (b[1] - a[1])) for k in range(count + 1)]
    left = []
    for place in places:
        i, j = square(place, lane_m)
        if not any((i + east, j + north) in passed for east, north in ABOUT):
            left.append(place)
    return (left[0], left[-1]) if left else None


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


# --- search ---

REACHED_M = 0.06  # of an end of a lane: a robot need not be there exactly
MIDDLE_M = 0.3  # of the tank: nearer, it is on no side
TURNS_RAD_S = 0.3  # what a frame showed 0.2 s ago is still in view when that is known
WAITS_NS = 2_500_000_000  # after the target was in view: for so long the gimbal turns to it, and looks
# An end of a lane that it comes no nearer to, by so much in such a time, is left out: a robot holds there, say.
NEARER_M, GIVES_UP_NS = 0.05, 15_000_000_000


class Approach(NamedTuple):
    """To a goal, the end of a lane for one."""

    nearest_m: float = math.inf
    in_vain_ns: int = 0  # for so long it has come no nearer

    def at(self, off_m: float, passed_ns: int) -> Approach:
        """Now, so far from it."""
        if off_m < self.nearest_m - NEARER_M:
            return Approach(off_m)
        return self._replace(in_vain_ns=self.in_vain_ns + passed_ns)

    @property
    def fails(self) -> bool:
        return self.in_vain_ns > GIVES_UP_NS


class Hunt(NamedTuple):
    """How far a search has come."""

    way: tuple[Planar, ...] = ()  # ends of lanes, in the order in which they are swum
    next: int = 0
    split: int = 0  # among how many the tank was divided
    crosswise: bool = False  # the lanes of every second round
    passed: Squares = frozenset()  # by all that search, in this round
    approach: Approach = Approach()
    waits_m: Planar | None = None  # where it stopped, to look or to measure
    seen_ns: int | None = None  # when the target was last in view
    done: bool = False

    def over(self, around: Surroundings, now_ns: int) -> bool:
        """Whether the target is known by now, or was once since the search began."""
        return self.done or known(around.target, now_ns)


def search(
    what: Search, hunt: Hunt, yaw: float, pose: Vector, around: Surroundings, now_ns: int, passed_ns: int
) -> tuple[Reference, Hunt]:
    """Where the robot shall be now. yaw: that it held until now, rad; passed_ns: in which it searched, since the step
    before."""
    here = pose[0], pose[1]
    if around.sees:
        hunt = hunt._replace(seen_ns=now_ns)
    if around.looks or (hunt.seen_ns is not None and now_ns - hunt.seen_ns < WAITS_NS):
        if hunt.waits_m is None:
            hunt, yaw = hunt._replace(waits_m=within_walls(here, around.tank_m)), pose[2]
        if around.looks and around.target is not None:
            x, y = around.target.x_m[0] - here[0], around.target.x_m[1] - here[1]
            yaw = facing(yaw, math.atan2(y, x))
        return Reference(hunt.waits_m or here, yaw), hunt
    hunt = _onwards(hunt._replace(waits_m=None), here, passed_ns)
    if not hunt.passed.issuperset(been := {square(place, what.lane_m) for place in (here, *around.fellows_m)}):
        hunt = hunt._replace(passed=hunt.passed | been)
    hunt = _with_goal(what, hunt, here, around)
    goal = hunt.way[hunt.next]
    if around.swims:  # it may come from anywhere: the wall behind the robot is where it is not
        ahead_m, least_m = (0.5 * around.tank_m[0], 0.5 * around.tank_m[1]), MIDDLE_M
    else:
        ahead_m, least_m = goal, REACHED_M
    x, y = ahead_m[0] - here[0], ahead_m[1] - here[1]
    yaw = math.atan2(y, x) if math.hypot(x, y) > least_m else yaw
    return Reference(goal, yaw, most_m_s=what.speed_m_s, most_rad_s=TURNS_RAD_S), hunt


def _onwards(hunt: Hunt, here: Planar, passed_ns: int) -> Hunt:
    """With the next goal once one is reached, or cannot be."""
    if hunt.next == len(hunt.way):
        return hunt
    off_m = math.dist(hunt.way[hunt.next], here)
    approach = hunt.approach.at(off_m, passed_ns)
    if off_m < REACHED_M or approach.fails:
        return hunt._replace(next=hunt.next + 1, approach=Approach())
    return hunt._replace(approach=approach)


def _with_goal(what: Search, hunt: Hunt, here: Planar, around: Surroundings) -> Hunt:
    """With a new way where there is none, or others divide the tank."""
    split = len(around.fellows_m) + 1
    if hunt.next < len(hunt.way) and hunt.split == split:
        return hunt
    part, begins = cell(here, around.fellows_m, around.tank_m), not hunt.way
    ends = () if begins or hunt.next == len(hunt.way) else lanes(part, what.lane_m, here, hunt.crosswise, hunt.passed)
    if not ends:  # all seen, and nothing found: now from other sides
        hunt = hunt._replace(passed=frozenset(), crosswise=not begins and not hunt.crosswise)
        ends = lanes(part, what.lane_m, here, hunt.crosswise)
    return hunt._replace(way=ends or (within_walls(here, around.tank_m),), next=0, split=split, approach=Approach())
