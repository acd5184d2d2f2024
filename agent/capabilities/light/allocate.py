"""Which lamps shall burn while one robot sweeps: flips of one lamp at a time, each kept if the sweep gains by it.

The same inputs give the same set on every robot and every processor: names are taken in their order, and the
logarithm of the information is rounded before two of them are compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from agent.capabilities.light.information import Worth, worth
from agent.capabilities.light.model import Pair, pair
from agent.core.config import Lighting
from agent.core.messages import Vector

ROUNDS = 2
LEAST_RISE = math.log(1.01)  # of log J, for which a lamp is flipped
GLARE_RAD = math.radians(
    20.0
)  # about the camera's axis: a lamp in there that aims at the target may shine into the lens


class Lamp(NamedTuple):
    """A lamp of the fleet where it is now. It is taken to aim at the target and burn at full power."""

    place_m: Vector  # world frame
    free: bool = True  # may be asked for: not lent, not needed for its robot's own sweep, armed, battery good


class Scene(NamedTuple):
    """What is about to be measured, by what camera."""

    camera_m: Vector  # optical centre, world frame
    axis: Vector  # unit vector of the optical axis, world frame
    target_m: Vector  # its centre
    radius_m: float  # of the ball, or about half of what else it is
    focal_px: float  # in water
    slope_mm: float  # millimetres of range for one lens position, at the target


class Choice(NamedTuple):
    """The lamps to burn. J is the information of the sweep: sigma falls with its root."""

    lamps: tuple[str, ...]  # names in order, never empty; (own,): borrow nothing
    log_j: float  # with these lamps
    own_log_j: float  # with the own lamp alone
    sigma_mm: float  # of the range, expected with these lamps
    usable: bool  # contrast and sigma are such that the sweep is worth making
    contrast: float = 0.0  # direct light of the target in all light, with these lamps
    own_contrast: float = 0.0  # with the own lamp alone


def allocate(own: str, scene: Scene, lamps: Mapping[str, Lamp], lighting: Lighting) -> Choice:
    """The set of lamps for the sweep of robot `own`, from all lamps by robot's name, its own included.

    Starts from the own lamp; in two rounds, in order of names, each free lamp is flipped, and the flip is kept if J
    rises by more than 1 %. The own lamp may go out, the set is never empty. If J then is not better than with the own
    lamp by the share lighting.gain, the answer is the own lamp. A lamp that would shine into the camera, within 20
    degrees of its axis, is left out. Whoever swims and measures passes free=False.

    Raises KeyError if `own` is not among the lamps.
    """
    depth_m = math.dist(scene.camera_m, scene.target_m)
    pairs = {
        name: pair(scene.camera_m, scene.target_m, scene.radius_m, lamp.place_m, lighting)
        for name, lamp in sorted(lamps.items())
        if name == own or (lamp.free and not dazzles(scene, lamp.place_m))
    }

    def of(names: frozenset[str]) -> Worth:
        burning: list[Pair] = [pairs[name] for name in sorted(names)]
        return worth(burning, depth_m, scene.radius_m, scene.focal_px, scene.slope_mm)

    alone = of(frozenset((own,)))
    chosen = improved(frozenset((own,)), pairs, lambda names: of(names).log_j, LEAST_RISE)
    best = of(chosen)
    if best.log_j <= alone.log_j + math.log1p(lighting.gain):
        chosen, best = frozenset((own,)), alone
    contrasts = best.contrast, alone.contrast
    return Choice(tuple(sorted(chosen)), best.log_j, alone.log_j, best.sigma_mm, best.usable, *contrasts)


def improved(
    chosen: frozenset[str], names: Iterable[str], value: Callable[[frozenset[str]], float], least: float
) -> frozenset[str]:
    """The set after two rounds in which each name is flipped, where that is worth more by so much; never empty."""
    names, best = tuple(names), value(chosen)
    for _ in range(ROUNDS):
        for name in names:
            flipped = chosen ^ {name}
            if flipped and (tried := value(flipped)) > best + least:
                chosen, best = flipped, tried
    return chosen


def dazzles(scene: Scene, lamp_m: Vector) -> bool:
    """Whether a lamp is in the picture, or nearly: it faces the target, and the camera behind that or before it."""
    offset = [p - c for p, c in zip(lamp_m, scene.camera_m, strict=True)]
    range_m = math.sqrt(sum(o * o for o in offset))
    if range_m == 0.0:
        return False
    ahead = sum(o * a for o, a in zip(offset, scene.axis, strict=True)) / range_m
    beyond = range_m > math.dist(scene.camera_m, scene.target_m)  # before the target, it shines away from the camera
    return beyond and ahead > math.cos(GLARE_RAD)
