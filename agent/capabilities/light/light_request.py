"""What a robot asks for: whose lamps for a sweep or a look at a place, where they aim, and for how long."""

from __future__ import annotations

import math
from typing import Any

from agent.capabilities.light.allocate import Choice, FrameChoice, FrameScene, axis_of, choose, others, scene_of
from agent.capabilities.light.lease import Party, Talk
from agent.capabilities.light.own_lamp import OwnLamp
from agent.core.attitude import Attitude
from agent.core.capability import Situation, eye_of
from agent.core.capability_messages import MOST_HOLDS_S, MOST_WAITED, Lease
from agent.core.config import Fleet, Lighting, Pose, Target
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, CameraFit, Eye, camera_pose, ray, to_world
from agent.core.ranging.focus import lens_position
from agent.core.ranging.pointing import SEARCH_DEG
from agent.core.step_transaction import Revertible

PATIENCE_NS = 6_000_000_000  # with a neighbour that looks for landmarks, and goes on and on


class Requests(Revertible):
    """Of one robot of a fleet with [lighting]."""

    def __init__(
        self, fleet: Fleet, name: str, calibration: Calibration, lighting: Lighting, own: OwnLamp, talk: Talk
    ) -> None:
        self._fleet, self.name, self._calibration = fleet, name, calibration
        self._lighting, self._own, self._talk = lighting, own, talk
        self._waits_ns: int | None = None  # since when a neighbour needs its light

    def choice(self, at_m: Vector, level: Attitude, situation: Situation) -> Choice | None:
        """By the rule, for the watched target there; None: it is too near, or nobody has a lamp."""
        eye, ball = eye_of(self._fleet, situation.camera, situation.pose, level), self._ball(situation)
        scene = scene_of(self._calibration, eye, ball, at_m)
        if scene is None:
            return None
        choice: Choice | None = self._chosen(scene, at_m, level, situation)
        return choice

    def frame_choice(self, scene: FrameScene, level: Attitude, situation: Situation) -> FrameChoice | None:
        """By the rule for whole frames; None: nobody has a lamp."""
        choice: FrameChoice | None = self._chosen(scene, scene.aim_m, level, situation)
        return choice

    def _chosen(self, scene: Any, at_m: Vector, level: Attitude, situation: Situation) -> Any:
        aim, words = self._own.aim, dict(self._talk.party.words)
        there = others(self._fleet, self.name, situation)
        swims = situation.own is not None  # and may be turned away from it
        near = {name: at for name, at in there.items() if name in words and (not swims or aim.at(at_m, *at)[1])}
        places_m = {name: aim.place_m(*at) for name, at in near.items()}
        lamps = {name: words[name].said.lamp for name in places_m}
        if self._own.burns:
            places_m[self.name], lamps[self.name] = aim.place_m(situation.pose, level), self._own.now
        return choose(self.name if self._own.burns else None, scene, places_m, lamps, self._lighting)

    def may_ask(self, situation: Situation) -> bool:
        """Whether nobody needs its own light now: a neighbour whose camera is at landmarks would see none."""
        now_ns, glance = situation.now_ns, any(each.at_landmarks for each in situation.neighbours or ())
        self._waits_ns = (self._waits_ns or now_ns) if glance else None
        return self._waits_ns is None or now_ns - self._waits_ns > PATIENCE_NS

    def lease(self, at_m: Vector | None, names: tuple[str, ...] | None, waited_ns: int, holds_ns: int) -> Lease:
        """The lease to ask for; names: whose lamps, None: the own one's."""
        waited = min(waited_ns // 100_000_000, MOST_WAITED)
        lamps: tuple[tuple[str, float], ...] = ((self.name, 1.0),) if self._own.burns else ()
        if names is not None:
            lamps = tuple((name, 1.0) for name in names)
        return Lease(0, waited, min(holds_ns * 1e-9, MOST_HOLDS_S), False, at_m, lamps)

    def sharp_at(self, at_m: Vector | None, situation: Situation) -> float | None:
        """Lens position at which the watched target would be sharp there; None: nobody knows."""
        if at_m is None or situation.level is None:
            return None
        eye = eye_of(self._fleet, situation.camera, situation.pose, situation.level)
        scene = scene_of(self._calibration, eye, self._ball(situation), at_m)
        if scene is None:
            return None
        return lens_position(self._calibration.swept, math.dist(scene.camera_m, scene.target_m) - scene.radius_m)

    def _ball(self, situation: Situation) -> Target:
        return self._fleet.target[situation.watched]


def glimpsed_m(fleet: Fleet, camera: CameraFit, far_m: float | None, situation: Situation) -> Vector | None:
    """About where the watched target in view is, world frame: the range by the size of a ball, else far_m. None: it is
    not in view, or its range is not known."""
    target, seen, level = situation.watched, situation.camera.seen, situation.level
    if target != situation.camera.target or seen is None or seen.centre_px is None or level is None:
        return None
    if not situation.camera.sees(target):
        return None
    radius_m, tank = fleet.target[target].radius_m, fleet.tank
    if radius_m is not None and seen.radius_px:
        far_m = radius_m * camera.f_px / seen.radius_px
    if far_m is None:
        return None
    x, y, z = ray(camera, seen.centre_px)
    at_m = to_world(eye_of(fleet, situation.camera, situation.pose, level), (far_m * x, far_m * y, far_m * z))
    x, y, z = (min(max(at, 0.0), most) for at, most in zip(at_m, (*tank.size_m[:2], tank.surface_m), strict=True))
    return x, y, z


# --- light for a search, while no robot knows where the target is ---
# Where a robot asks for light while nobody knows where the target is.
#
# A lamp beside the camera shows what is near. Farther out its veil outshines every target, and a neighbour's lamp
# from aside shows what it does not. So a robot that has looked by its own lamp and found nothing has places lit, one
# by one: ahead of it and to either side, then the same farther out. A place counts where the lamps that the rule
# names there would show a target to this camera, and the own lamp would not. A robot that knows no more looks there as
# well, while it is lit.
#
# A robot that swims in search of a target asks for none (pointing.py): it comes near what its own lamp shows,
# and lent light, for which all hold still, found neither balls nor fish sooner (docs/night.md).

# From the camera. A lamp that shines on a place from 1.3 m away and 45 degrees aside lights the camera's axis from
# 0.7 m before it to 0.7 m behind; nearer than that the own lamp shows what there is.
RANGES_M = (1.4, 2.0)
LEAST_M = 0.4
# Of a target's light in all light: by more of it the ball is found in the twin's pictures, sharp or not, by less its
# own lamp does not show it (harbour water, worlds 2 and 10, 0.7 to 1.5 m).
SHOWS = 0.2
SHOWS_SIDE = 0.35  # likewise, of what is no ball: less shows it in no frame, more its side in nearly all
OWN_LOOK_NS = 1_200_000_000  # by the own lamp, before light is asked for: four frames
SHOWN_NS = 900_000_000  # of light and gimbal at rest, without a target: three frames


class LightSearch(Revertible):
    """Of one robot that looks for a target from where it is, between steps."""

    def __init__(self, fleet: Fleet, name: str, camera: CameraFit) -> None:
        self._fleet, self._name, self._robot, self._camera = fleet, name, fleet.robot[name], camera
        self._step = 0
        self._glimpsed_m: Vector | None = None
        self._looks_ns: int | None = None  # since when, by the own lamp
        self.at_m: Vector | None = None  # that the own lease is about

    def look(self, situation: Situation, burns: bool) -> bool:
        """Whether the own lamp has shown by now what it can; burns: it can burn. Others' light in between counts as
        well."""
        camera, lit_ns = situation.camera, situation.light.from_ns
        if situation.search is not None:
            return False
        if self._looks_ns is None and lit_ns is not None and camera.goal_us is not None:
            self._looks_ns = max(lit_ns, camera.steady_from_ns)
        return not burns or (self._looks_ns is not None and situation.now_ns - self._looks_ns > OWN_LOOK_NS)

    def place(self, pose: Pose, level: Attitude) -> Vector | None:
        """The one whose turn it is, no farther than the tank's walls; None: that is too near, or out of the gimbal's
        reach."""
        if self._glimpsed_m is not None:
            return self._glimpsed_m
        (pan, tilt), far_m = self._way_deg(), RANGES_M[self._step // len(SEARCH_DEG) % len(RANGES_M)]
        body, tank = self._fleet.body, self._fleet.tank
        limits = body.pan_limit_deg, body.tilt_limit_deg
        if not all(low <= deg <= high for deg, (low, high) in zip((pan, tilt), limits, strict=True)):
            return None
        return self._along(camera_pose(pose, body, *level, pan, tilt, tank.surface_m), far_m)

    def _along(self, eye: Eye, far_m: float) -> Vector | None:
        """So far ahead of a camera, but for walls; None: these are too near."""
        tank = self._fleet.tank
        way, walls_m = axis_of(eye), (*tank.size_m[:2], tank.surface_m)
        for at, part, most_m in zip(eye.position_m, way, walls_m, strict=True):
            if part:
                far_m = min(far_m, ((most_m if part > 0.0 else 0.0) - at) / part)
        if far_m < LEAST_M:
            return None
        x, y, z = (at + far_m * part for at, part in zip(eye.position_m, way, strict=True))
        return x, y, z

    def worth(self, choice: Choice | None, target: Target, burns: bool) -> bool:
        """Whether those lamps show what the own lamp does not; burns: it can burn."""
        least = SHOWS if target.radius_m else SHOWS_SIDE
        if choice is None or choice.contrast < least or choice.lamps == (self._name,):
            return False
        return not burns or choice.own_contrast < least

    def shown(self, granted_ns: int, situation: Situation) -> bool:
        """Whether a target at the place would have been seen by now, by the light that was granted then."""
        lit_ns = situation.light.from_ns
        if lit_ns is None or lit_ns < granted_ns:
            return False
        return situation.now_ns - max(lit_ns, situation.camera.steady_from_ns) > SHOWN_NS

    def follows(self, party: Party, situation: Situation) -> Vector | None:
        """The place that is lit, by anybody's lease, for the camera to look at. What it sees there by another's is its
        own next place."""
        if party.bound is None:
            return self.at_m if party.mine is not None and party.mine.granted else None
        lit_m, level = party.bound.lease.at_m, situation.level
        if lit_m is not None and level is not None and not situation.camera.tracks:  # all know of what swims at once
            eye = eye_of(self._fleet, situation.camera, situation.pose, level)
            far_m = math.dist(lit_m, eye.position_m)
            self._glimpsed_m = glimpsed_m(self._fleet, self._camera, far_m, situation) or self._glimpsed_m
        return lit_m

    def have_lit(self, at_m: Vector | None) -> None:
        """The own lease is about that place of the search; None: about what is known or seen."""
        self.at_m = at_m

    def advance(self) -> None:
        """On to the next place, for ever."""
        if self._glimpsed_m is None:
            self._step += 1
        self._glimpsed_m = self.at_m = None

    def _way_deg(self) -> tuple[float, float]:
        """Pan and tilt of the place whose turn it is."""
        pan, tilt = SEARCH_DEG[self._step % len(SEARCH_DEG)]
        return self._robot.look.pan_deg + pan, self._robot.look.tilt_deg + tilt
