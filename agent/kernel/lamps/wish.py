"""What a robot asks for: whose lamps for a sweep or a look at a place, where they aim, and for how long."""

from __future__ import annotations

import math

from agent.kernel.config import Fleet, Target
from agent.kernel.control.attitude import Attitude
from agent.kernel.control.seek import Seek
from agent.kernel.lamps.aim import others
from agent.kernel.lamps.choose import choose, scene_of
from agent.kernel.lamps.own_lamp import OwnLamp
from agent.kernel.lamps.talk import Talk
from agent.kernel.lighting.allocate import Choice
from agent.kernel.lighting.settings import Lighting
from agent.kernel.lighting.words import MOST_HOLDS_S, MOST_WAITED, Lease
from agent.kernel.messages import Vector
from agent.kernel.navigation.swimmer import Swimmer
from agent.kernel.ranging.calibration import Calibration
from agent.kernel.ranging.focus import lens_position


class Wishes:
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
        self._fleet, self._name, self._calibration, self._swimmer = fleet, name, calibration, swimmer
        self._lighting, self._own, self._talk = lighting, own, talk

    def choice(self, seek: Seek, ball: Target, at_m: Vector, level: Attitude) -> Choice | None:
        """By the rule, for a target there; None: it is too near, or nobody has a lamp."""
        scene = scene_of(self._calibration, seek.eye(level), ball, at_m)
        if scene is None:
            return None
        aim, words = self._own.aim, dict(self._talk.party.words)
        there = others(self._fleet, self._name, self._swimmer)
        places_m = {name: aim.place_m(*at) for name, at in there.items() if name in words}
        lamps = {name: words[name].said.lamp for name in places_m}
        if self._own.has:
            places_m[self._name], lamps[self._name] = aim.place_m(seek.pose, level), self._own.now
        return choose(self._name if self._own.has else None, scene, places_m, lamps, self._lighting)

    def lease(self, at_m: Vector | None, choice: Choice | None, waited_ns: int, holds_ns: int) -> Lease:
        """The lease to ask for; without a choice the own lamp's."""
        waited = min(waited_ns // 100_000_000, MOST_WAITED)
        lamps: tuple[tuple[str, float], ...] = ((self._name, 1.0),) if self._own.has else ()
        if choice is not None:
            lamps = tuple((name, 1.0) for name in choice.lamps)
        return Lease(0, waited, min(holds_ns * 1e-9, MOST_HOLDS_S), False, at_m, lamps)

    def sharp_at(self, seek: Seek, ball: Target, at_m: Vector | None, level: Attitude | None) -> float | None:
        """Lens position at which a target there would be sharp; None: nobody knows."""
        if at_m is None or level is None:
            return None
        scene = scene_of(self._calibration, seek.eye(level), ball, at_m)
        if scene is None:
            return None
        return lens_position(self._calibration.focus, math.dist(scene.camera_m, scene.target_m) - scene.radius_m)
