"""Whose lamps burn while robots follow a target that swims, and one robot's part in that.

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

from agent.capabilities.light.allocate import Aim, Scene, dazzles, place_of, scene_of, worth
from agent.capabilities.light.lease import Party, listeners
from agent.capabilities.light.model import Pair, pair
from agent.capabilities.swim.pursuit import AHEAD_S, ALL_LOST_NS, carried_on
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.attitude import Attitude
from agent.core.capability_messages import LampNow
from agent.core.config import Fleet, Lighting, Pose
from agent.core.control.target_search import Seek
from agent.core.estimation.protocols import dynamics, pursued
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, camera_pose
from agent.core.step_transaction import Revertible
from agent.core.target_state import TargetState

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


# --- light for a target that swims ---
# A robot's own part in the light by which what swims is followed: what it knows of who is where, made a decision.
#
# The rule is lighting/followers.py's. What it costs is spread over steps: each looks at what lamps do for one
# follower, and after the last one it is decided. Who looks for landmarks needs its lamp for that, sees nothing of the
# target meanwhile, and counts neither as a follower nor as a lamp.


class Wish(NamedTuple):
    """Of the own lamp."""

    burns: bool
    at_m: Vector  # where the target will be when its gimbal has got there


class Known(NamedTuple):
    """Of one step."""

    target: TargetState
    at_m: Vector
    places: Mapping[str, tuple[Pose, Attitude]]  # of all robots whose place is known, the own one too
    followers: tuple[str, ...]  # whose cameras are at the target, by name
    lamps_m: Mapping[str, Vector]  # of those that can burn, aimed at it


class FollowLight(Revertible):
    """Of one robot that swims, between steps."""

    def __init__(
        self, fleet: Fleet, name: str, calibration: Calibration, swimmer: Swimmer, lighting: Lighting, aim: Aim
    ) -> None:
        self._fleet, self._name, self._calibration, self._swimmer = fleet, name, calibration, swimmer
        self._lighting, self._aim, self._swims = lighting, aim, pursued(fleet)
        self._views = dict[str, View]()
        self._to_view = list[str]()  # followers whose turn is still to come
        self._held: Held | None = None  # None: each lamp goes with its own camera

    def tick(
        self,
        targets: Mapping[str, TargetState],
        party: Party,
        own: LampNow,
        seek: Seek,
        level: Attitude | None,
        now_ns: int,
    ) -> Wish | None:
        """What the own lamp shall do from now on; None: it goes with its camera."""
        known = None if level is None else self._known(targets, party, own, seek, level, now_ns)
        if known is None or not known.followers or not known.lamps_m:
            self._held, self._to_view = None, []
            self._views.clear()
        elif not self._to_view:
            self._to_view = list(known.followers)
        else:
            self._look(self._to_view.pop(0), known)
            if not self._to_view:
                self._decide(known, party, own, now_ns)
        if known is None or self._held is None or self._name not in known.places or self._elsewhere(seek):
            return None
        return Wish(self._name in self._held.lamps, known.at_m)

    def _look(self, follower: str, known: Known) -> None:
        """What lamps do for that one."""
        self._views.pop(follower, None)
        if follower not in known.followers:
            return
        pose, level = known.places[follower]
        eye = camera_pose(pose, self._fleet.body, *level, 0.0, 0.0, self._fleet.tank.surface_m)
        scene = scene_of(self._calibration, eye, known.target.ball, known.at_m)
        if scene is not None:
            self._views[follower] = view(scene, known.lamps_m, self._lighting)

    def _decide(self, known: Known, party: Party, own: LampNow, now_ns: int) -> None:
        views = [self._views[name] for name in known.followers if name in self._views]
        names = [name for name in known.lamps_m if all(name in each.pairs for each in views)]
        powers = {name: word.said.lamp.power for name, word in party.words} | {self._name: own.power}
        burning = frozenset(name for name in names if powers[name] > 0.0)
        self._held = decided(self._held or Held(), views, names, burning, self._lighting.gain, now_ns)

    def _known(
        self, targets: Mapping[str, TargetState], party: Party, own: LampNow, seek: Seek, level: Attitude, now_ns: int
    ) -> Known | None:
        """None: nobody follows anything, or knows where it is."""
        neighbours = self._swimmer.company.neighbours
        said = {name: each.newest.message for name, each in neighbours.letters.senders.items() if each.newest}
        about = {name: said[name].target or None for name in listeners(party, now_ns) if name in said}
        about[self._name] = self._swimmer.about
        followed = [name for name in self._swims if name in about.values()]
        if not followed:
            return None
        name = next((name for name in followed if name == about[self._name]), followed[0])
        target = targets[name]
        estimate, believed = target.estimate(now_ns), target.estimator.posterior
        if estimate is None or believed is None or now_ns - estimate.seen_ns > ALL_LOST_NS:
            return None
        at_m = carried_on(believed, dynamics(target.ball), now_ns + round(AHEAD_S * 1e9))
        places = {other: place_of(said[other]) for other in about if other in said}
        away = set(neighbours.glancing(now_ns))
        if self._swimmer.here is not None:
            places[self._name] = seek.pose, level
        if self._elsewhere(seek):
            away.add(self._name)
        there = {other: at for other, at in sorted(places.items()) if other not in away}
        lamps = {other: word.said.lamp for other, word in party.words} | {self._name: own}
        lamps_m = {
            other: self._aim.place_m(*at)
            for other, at in there.items()
            if other in lamps and lamps[other].cannot in ("", "moves") and self._aim.at(at_m, *at)[1]
        }
        followers = tuple(other for other in there if about[other] == name)
        return Known(target, at_m, places, followers, lamps_m)

    def _elsewhere(self, seek: Seek) -> bool:
        """The own camera is not at the target."""
        return self._swimmer.glances or seek.roam is not None or seek.surveys
