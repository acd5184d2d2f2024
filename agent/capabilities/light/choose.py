"""Which lamps to ask for: the rule of allocate.py, and what it costs those who lend.

A lamp that is warm, or whose robot's battery runs low, is asked for only if the sweep gains as much by it as by
borrowed light at all: the rule is asked twice, without and with the loaded ones.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import overload

from agent.capabilities.light.allocate import Choice, Lamp, Scene, allocate
from agent.capabilities.light.frames import FrameChoice, FrameScene, allocate_frame
from agent.capabilities.light.lamp import LENDS_BELOW
from agent.core.capability_messages import LampNow
from agent.core.config import Lighting, Target
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye
from agent.core.ranging.focus import lens_position

LOADED = 0.5  # of what it may be, or empty: from there on a lamp costs
THING_M = 0.05  # half of what a target is whose size nobody knows
NEAREST_M = 0.05  # of a target, before the camera


def scene_of(calibration: Calibration, eye: Eye, target: Target, target_m: Vector) -> Scene | None:
    """What is about to be measured; None: too near to be."""
    away = tuple(to - at for to, at in zip(target_m, eye.position_m, strict=True))
    distance_m = math.sqrt(sum(x * x for x in away))
    radius_m = target.radius_m or (0.5 * target.length_m if target.length_m else THING_M)
    skin_m = distance_m - radius_m
    if skin_m <= max(calibration.focus.u_inf_m, 0.0) + NEAREST_M:
        return None
    x, y, z = (part / distance_m for part in away)
    fit = calibration.focus
    travel = lens_position(fit, skin_m) - fit.rho0  # dh / drho = -b / travel^2
    slope_mm = 1000.0 * abs(fit.b_m) / (travel * travel)
    return Scene(eye.position_m, (x, y, z), target_m, radius_m, calibration.camera.f_px, slope_mm)


@overload
def choose(
    own: str | None, scene: Scene, places_m: Mapping[str, Vector], lamps: Mapping[str, LampNow], lighting: Lighting
) -> Choice | None: ...
@overload
def choose(
    own: str | None, scene: FrameScene, places_m: Mapping[str, Vector], lamps: Mapping[str, LampNow], lighting: Lighting
) -> FrameChoice | None: ...
def choose(
    own: str | None,
    scene: Scene | FrameScene,
    places_m: Mapping[str, Vector],
    lamps: Mapping[str, LampNow],
    lighting: Lighting,
) -> Choice | FrameChoice | None:
    """Whose lamps shall burn, for a target or a whole view. own: who sweeps; None: it has no lamp. places_m: of all
    lamps that are known; lamps: as their robots say. None: nobody has one."""
    free = {name for name, lamp in lamps.items() if not lamp.cannot and lamp.load < LENDS_BELOW and name != own}
    fresh = {name for name in free if lamps[name].load < LOADED}
    first = _best(own, scene, places_m, fresh, lighting)
    if fresh == free:
        return first
    second = _best(own, scene, places_m, free, lighting)
    if first is None or second is None:
        return first or second
    return second if second.log_j > first.log_j + math.log1p(lighting.gain) else first


def _best(
    own: str | None,
    scene: Scene | FrameScene,
    places_m: Mapping[str, Vector],
    free: set[str],
    lighting: Lighting,
) -> Choice | FrameChoice | None:
    """By the rule. Of a robot without a lamp it starts from each of the others in turn."""
    starts = [own] if own is not None else sorted(free)
    choices: list[Choice | FrameChoice] = []
    for start in starts:
        lamps = {name: Lamp(place_m, name in free or name == start) for name, place_m in places_m.items()}
        if isinstance(scene, FrameScene):
            choices.append(allocate_frame(start, scene, lamps, lighting))
        else:
            choices.append(allocate(start, scene, lamps, lighting))
    return max(choices, key=lambda choice: round(choice.log_j, 6), default=None)
