"""What a robot asks for: whose lamps for a sweep or a look at a place, where they aim, and for how long."""

from __future__ import annotations

import math
from typing import Any

from agent.capabilities.light.aim import others
from agent.capabilities.light.allocate import Choice
from agent.capabilities.light.choose import choose, scene_of
from agent.capabilities.light.frames import FrameChoice, FrameScene
from agent.capabilities.light.own_lamp import OwnLamp
from agent.capabilities.light.talk import Talk
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.attitude import Attitude
from agent.core.capability_messages import MOST_HOLDS_S, MOST_WAITED, Lease
from agent.core.config import Fleet, Lighting, Target
from agent.core.control.target_search import Seek
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration
from agent.core.ranging.focus import lens_position
from agent.core.step_transaction import Revertible

PATIENCE_NS = 6_000_000_000  # with a neighbour that looks for landmarks, and goes on and on


class Wishes(Revertible):
    """Of one robot of a fleet with [lighting]."""

    def __init__(
        self,
        fleet: Fleet,
        name: str,
        calibration: Calibration,
        swimmer: Swimmer | None,
        lighting: Lighting,
        own: OwnLamp,
        talk: Talk,
    ) -> None:
        self._fleet, self.name, self._calibration, self._swimmer = fleet, name, calibration, swimmer
        self._lighting, self._own, self._talk = lighting, own, talk
        self._waits_ns: int | None = None  # since when a neighbour needs its light

    def choice(self, seek: Seek, ball: Target, at_m: Vector, level: Attitude) -> Choice | None:
        """By the rule, for a target there; None: it is too near, or nobody has a lamp."""
        scene = scene_of(self._calibration, seek.eye(level), ball, at_m)
        if scene is None:
            return None
        choice: Choice | None = self._chosen(scene, at_m, seek, level)
        return choice

    def frame_choice(self, seek: Seek, scene: FrameScene, level: Attitude) -> FrameChoice | None:
        """By the rule for whole frames; None: nobody has a lamp."""
        choice: FrameChoice | None = self._chosen(scene, scene.aim_m, seek, level)
        return choice

    def _chosen(self, scene: Any, at_m: Vector, seek: Seek, level: Attitude) -> Any:
        aim, words = self._own.aim, dict(self._talk.party.words)
        there = others(self._fleet, self.name, self._swimmer)
        swims = self._swimmer is not None  # and may be turned away from it
        near = {name: at for name, at in there.items() if name in words and (not swims or aim.at(at_m, *at)[1])}
        places_m = {name: aim.place_m(*at) for name, at in near.items()}
        lamps = {name: words[name].said.lamp for name in places_m}
        if self._own.has:
            places_m[self.name], lamps[self.name] = aim.place_m(seek.pose, level), self._own.now
        return choose(self.name if self._own.has else None, scene, places_m, lamps, self._lighting)

    def may_ask(self, now_ns: int) -> bool:
        """Whether nobody needs its own light now: a neighbour whose camera is at landmarks would see none."""
        glance = self._swimmer is not None and self._swimmer.company.neighbours.glancing(now_ns)
        self._waits_ns = (self._waits_ns or now_ns) if glance else None
        return self._waits_ns is None or now_ns - self._waits_ns > PATIENCE_NS

    def lease(self, at_m: Vector | None, names: tuple[str, ...] | None, waited_ns: int, holds_ns: int) -> Lease:
        """The lease to ask for; names: whose lamps, None: the own one's."""
        waited = min(waited_ns // 100_000_000, MOST_WAITED)
        lamps: tuple[tuple[str, float], ...] = ((self.name, 1.0),) if self._own.has else ()
        if names is not None:
            lamps = tuple((name, 1.0) for name in names)
        return Lease(0, waited, min(holds_ns * 1e-9, MOST_HOLDS_S), False, at_m, lamps)

    def sharp_at(self, seek: Seek, ball: Target, at_m: Vector | None, level: Attitude | None) -> float | None:
        """Lens position at which a target there would be sharp; None: nobody knows."""
        if at_m is None or level is None:
            return None
        scene = scene_of(self._calibration, seek.eye(level), ball, at_m)
        if scene is None:
            return None
        return lens_position(self._calibration.focus, math.dist(scene.camera_m, scene.target_m) - scene.radius_m)
