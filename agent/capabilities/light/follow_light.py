"""A robot's own part in the light by which what swims is followed: what it knows of who is where, made a decision.

The rule is lighting/followers.py's. What it costs is spread over steps: each looks at what lamps do for one follower,
and after the last one it is decided. Who looks for landmarks needs its lamp for that, sees nothing of the target
meanwhile, and counts neither as a follower nor as a lamp.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from agent.capabilities.light.aim import Aim, place_of
from agent.capabilities.light.choose import scene_of
from agent.capabilities.light.followers import Held, View, decided, view
from agent.capabilities.light.lease import Party, listeners
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
