"""How many blocks of a keyframe would show a clear peak, by the lamps that burn: whole frames instead of one target.

Light on spots of what the view is expected to show, and the veil before each; all lamps aim at one place of it. The
exposure is that of the whole frame, so that what lies near a lamp is paid for by all that lies far from it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from agent.capabilities.light.allocate import Lamp, improved
from agent.capabilities.light.information import ELECTRONS, LEVEL, MAX_GAIN, READ_NOISE, WELL
from agent.capabilities.light.model import ALBEDO, FORWARD, Colours, beam_share, single_veil
from agent.capabilities.light.orders import all_orders
from agent.core.config import Lighting
from agent.core.messages import Vector

STEPS = 40  # along a ray: a spot's veil to 1 %, which stands for that of many blocks
VIEW_GLARE_RAD = math.radians(30.0)  # about the axis, as allocate's; a whole frame is wider
# log J at which half of the blocks show a peak, and how steeply more of it shows more: by the keyframes of world 0, in
# harbour and bay water (tests/bench/light/bench_keyframes.py). Concrete and stones have less texture than a ball.
HALF_AT, SLOPE = 12.0, 1.0
LEAST_BLOCKS = 1e-3
LEAST_RISE = math.log(1.01)  # as allocate's


class Spot(NamedTuple):
    """A place that the view is expected to show."""

    at_m: Vector  # world frame
    normal: Vector  # unit vector out of its surface
    blocks: float  # for which it stands; of those whose place is known well enough it has none


class FrameScene(NamedTuple):
    """What is about to be swept."""

    camera_m: Vector  # optical centre, world frame
    axis: Vector  # unit vector of the optical axis, world frame
    aim_m: Vector  # of all lamps
    spots: tuple[Spot, ...]
    block_px: int  # side of a block


class Lit(NamedTuple):
    """What one lamp does for each of the spots: light that comes from it, and light before it."""

    direct: tuple[Colours, ...]
    veil: tuple[Colours, ...]


class FrameChoice(NamedTuple):
    lamps: tuple[str, ...]  # names in order, never empty; (own,): borrow nothing
    blocks: float  # that are expected to show a peak
    own_blocks: float  # with the own lamp alone

    @property
    def log_j(self) -> float:
        """By which choices are compared, as of a Choice."""
        return math.log(max(self.blocks, LEAST_BLOCKS))


def lit(scene: FrameScene, lamp_m: Vector, lighting: Lighting) -> Lit:
    """A lamp at full power, at lamp_m (world frame)."""
    return Lit(
        tuple(_direct(scene, spot, lamp_m, lighting) for spot in scene.spots),
        tuple(_veil(scene.camera_m, spot.at_m, lamp_m, lighting) for spot in scene.spots),
    )


def log_js(scene: FrameScene, lits: Sequence[Lit]) -> list[float]:
    """log J of a block at each spot, with all these lamps: J = n D^2 / (D + B + r^2), in electrons, n pixels."""
    direct = [sum(sum(one.direct[k]) for one in lits) / 3.0 * ELECTRONS for k in range(len(scene.spots))]
    veil = [sum(sum(one.veil[k]) for one in lits) / 3.0 * ELECTRONS for k in range(len(scene.spots))]
    top = max((d + b for d, b in zip(direct, veil, strict=True)), default=0.0)
    share = min(LEVEL * WELL / max(top, 1e-12), 1.0)
    gain = min(max(LEVEL * WELL / max(top * share, 1e-12), 1.0), MAX_GAIN)
    read = READ_NOISE * READ_NOISE / gain
    pixels = scene.block_px * scene.block_px
    return [
        math.log(max(pixels * (d * share) ** 2 / ((d + b) * share + read), 1e-9))
        for d, b in zip(direct, veil, strict=True)
    ]


def shown(scene: FrameScene, lits: Sequence[Lit]) -> float:
    """How many blocks are expected to show a peak. Rounded: exp differs between processors in its last bit, a decision
    must not."""
    found = 0.0
    for spot, log_j in zip(scene.spots, log_js(scene, lits), strict=True):
        found += spot.blocks / (1.0 + math.exp(min(max((HALF_AT - log_j) / SLOPE, -50.0), 50.0)))
    return round(found, 6)


def allocate_frame(own: str, scene: FrameScene, lamps: Mapping[str, Lamp], lighting: Lighting) -> FrameChoice:
    """As allocate.allocate, for a keyframe."""
    lits = {
        name: lit(scene, lamp.place_m, lighting)
        for name, lamp in sorted(lamps.items())
        if name == own or (lamp.free and not glares(scene, lamp.place_m))
    }

    def of(names: frozenset[str]) -> float:
        return math.log(max(shown(scene, [lits[name] for name in sorted(names)]), LEAST_BLOCKS))

    alone = frozenset((own,))
    chosen = improved(alone, lits, of, LEAST_RISE)
    if of(chosen) <= of(alone) + math.log1p(lighting.gain):
        chosen = alone
    blocks, own_blocks = (shown(scene, [lits[name] for name in sorted(names)]) for names in (chosen, alone))
    return FrameChoice(tuple(sorted(chosen)), blocks, own_blocks)


def glares(scene: FrameScene, lamp_m: Vector) -> bool:
    """Whether a lamp that aims at the view shines into the camera."""
    offset = [p - c for p, c in zip(lamp_m, scene.camera_m, strict=True)]
    range_m = math.sqrt(sum(o * o for o in offset))
    if range_m <= math.dist(scene.camera_m, scene.aim_m):
        return False
    return sum(o * a for o, a in zip(offset, scene.axis, strict=True)) > math.cos(VIEW_GLARE_RAD) * range_m


def _direct(scene: FrameScene, spot: Spot, lamp_m: Vector, lighting: Lighting) -> Colours:
    water, beam = lighting.water, lighting.beam
    way = [at - lamp for at, lamp in zip(spot.at_m, lamp_m, strict=True)]
    aim = [at - lamp for at, lamp in zip(scene.aim_m, lamp_m, strict=True)]
    r = max(math.sqrt(sum(x * x for x in way)), 1e-6)
    facing = -sum(w * n for w, n in zip(way, spot.normal, strict=True)) / r
    if facing <= 0.0:
        return 0.0, 0.0, 0.0
    aligned = sum(w * a for w, a in zip(way, aim, strict=True)) / (r * max(math.sqrt(sum(x * x for x in aim)), 1e-6))
    off = math.acos(min(max(aligned, -1.0), 1.0))
    z = math.dist(spot.at_m, scene.camera_m)
    on = ALBEDO / math.pi * beam.intensity_w_sr * beam_share(off, math.radians(beam.half_deg)) * facing / (r * r)
    blue, green, red = (
        on * math.exp(-(a + FORWARD * b) * r - (a + b) * z)
        for a, b in zip(water.absorption_per_m, water.scattering_per_m, strict=True)
    )
    return blue, green, red


def _veil(camera_m: Vector, at_m: Vector, lamp_m: Vector, lighting: Lighting) -> Colours:
    """Before a spot; the beam is flat so far that a lamp is taken to aim at it."""
    depth_m = max(math.dist(camera_m, at_m), 1e-6)
    along = [(at - c) / depth_m for at, c in zip(at_m, camera_m, strict=True)]
    offset = [p - c for p, c in zip(lamp_m, camera_m, strict=True)]
    ahead_m = sum(a * o for a, o in zip(along, offset, strict=True))
    aside_m = math.sqrt(max(sum(o * o for o in offset) - ahead_m * ahead_m, 0.0))
    single = single_veil(depth_m, 0.0, ahead_m, aside_m, lighting.water, lighting.beam, steps=STEPS)
    times = all_orders(depth_m, ahead_m, aside_m, lighting.water)
    blue, green, red = (s * f for s, f in zip(single, times, strict=True))
    return blue, green, red
