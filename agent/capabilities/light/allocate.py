"""Which lamps burn while one robot sweeps: what a sweep is worth in their light, the choice of lamps by flips of one
lamp at a time, what a choice costs robots that lend, and where lamps point. A flip is kept if the sweep gains by it.

The same inputs give the same set on every robot and every processor: names are taken in their order, and the
logarithm of the information is rounded before two of them are compared.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple, overload

from msgspec.structs import replace

from agent.capabilities.light.model import (
    ALBEDO,
    FORWARD,
    INNER,
    Colours,
    Pair,
    all_orders,
    beam_share,
    pair,
    single_veil,
)
from agent.core.attitude import Attitude
from agent.core.capability import Situation
from agent.core.capability_messages import LampNow, Why
from agent.core.config import Body, Fleet, Lighting, Pose, Target
from agent.core.messages import Vector
from agent.core.ranging.camera_model import Calibration, Eye, camera_pose, look_at
from agent.core.ranging.focus import lens_position
from agent.core.ranging.pointing import HIGHEST_US, LOWEST_US, SLEW_US_PER_S
from agent.core.step_io import Telemetry

# --- information of a focus sweep ---
# What a focus sweep is worth in the light of a set of lamps: J, by which the range's variance falls.
#
# The exposure is that which this set gets: a lamp too near to a target burns it out, and is paid for by all others.
# The camera's figures are those of its data sheet.

ELECTRONS = 3.4e5  # of a pixel for each W/m2/sr in a colour, exposed as long as a frame takes
WELL = 4000.0  # electrons
READ_NOISE = 16.0  # electrons, at gain 1
MAX_GAIN = 8.0
LEVEL = 0.8  # of full scale: what the exposure gives to the brightest 2 % of the disc
BRIGHTEST = 0.98
SIGMA = 1000.0  # lens positions at J = 1: of the twin's sweeps in harbour and bay water, world 0
# Direct light in all light, of a grey target, below which half of the sweeps and more show no peak; world 0, too.
LEAST_CONTRAST = 0.05
WORST_MM = 60.0
LEAST_J = 1e-9


class Worth(NamedTuple):
    log_j: float  # rounded to 1e-6: exp differs between processors in its last bit, a decision must not
    contrast: float  # mean of the direct light over that of all light
    sigma_mm: float
    usable: bool


def worth(pairs: Sequence[Pair], depth_m: float, radius_m: float, focal_px: float, slope_mm: float) -> Worth:
    """Of one sweep with all these lamps on. slope_mm: millimetres of range for a lens position.

    J = n mean(D^2 / (D + B + r^2)) mean(D)^2 / mean(D^2), in electrons, over n pixels of the inner disc. The last
    factor counts a disc less that lies half in the dark.
    """
    points = len(pairs[0].direct)
    veil = sum(sum(pair.veil) for pair in pairs) / 3.0 * ELECTRONS
    direct = [sum(sum(pair.direct[i]) for pair in pairs) / 3.0 * ELECTRONS for i in range(points)]
    top = sorted(direct)[min(int(BRIGHTEST * points), points - 1)] + veil
    share = min(LEVEL * WELL / max(top, 1e-12), 1.0)
    gain = min(max(LEVEL * WELL / max(top * share, 1e-12), 1.0), MAX_GAIN)
    read = READ_NOISE * READ_NOISE / gain
    mean = mean_square = signal = 0.0
    for d in direct:
        d *= share
        mean += d / points
        mean_square += d * d / points
        signal += d * d / (d + veil * share + read) / points
    pixels = math.pi * (focal_px * INNER * radius_m / depth_m) ** 2
    even = mean * mean / mean_square if mean_square > 0.0 else 0.0
    log_j = round(math.log(max(pixels * signal * even, LEAST_J)), 6)
    contrast = mean / (mean + veil * share) if mean > 0.0 else 0.0
    sigma_mm = SIGMA * slope_mm * math.exp(-0.5 * log_j)
    return Worth(log_j, contrast, sigma_mm, contrast > LEAST_CONTRAST and sigma_mm < WORST_MM)


# --- allocation of lamps ---

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
    degrees of its axis, is left out. A robot that swims and measures passes free=False.

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


# --- whole frames ---
# How many blocks of a keyframe would show a clear peak, by the lamps that burn: whole frames instead of one target.
#
# Light on spots of what the view is expected to show, and the veil before each; all lamps aim at one place of it. The
# exposure is that of the whole frame, so that what lies near a lamp is paid for by all that lies far from it.

STEPS = 40  # along a ray: a spot's veil to 1 %, which stands for that of many blocks
VIEW_GLARE_RAD = math.radians(30.0)  # about the axis, as allocate's; a whole frame is wider
# log J at which half of the blocks show a peak, and how steeply more of it shows more: by the keyframes of world 0, in
# harbour and bay water. Concrete and stones have less texture than a ball.
HALF_AT, SLOPE = 12.0, 1.0
LEAST_BLOCKS = 1e-3


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


# --- the robot's own lamp ---
# A robot's own lamp: what it is told, since when it rests, and what it can still give.

DARK_NS = 150_000_000  # from a set-point to light or darkness: the line to the module, its loop, the lamp's driver
SERVO_NS = 300_000_000  # lag of a servo at the end of a turn, and what a small move does to the body
# How warm a lamp gets in water is assumed, not measured: as warm as it may be after three and a half minutes at full
# power, and two minutes until it has cooled by two thirds.
WARMS_S, COOLS_S = 100.0, 120.0
TOO_WARM = 1.0  # share of what it may be
FULL_V, EMPTY_V = 14.8, 13.2  # of four cells under light load; the control module calls 12 V low
LENDS_BELOW = 0.9  # of whichever load is more; above, a robot keeps its light for itself


class OrderedLight(NamedTuple):
    """How somebody has ordered a lamp to burn, until he orders otherwise."""

    light: float  # share of full power
    pan_deg: float
    tilt_deg: float


class LampControl(NamedTuple):
    """As commanded. Pulses are those of its gimbal, pan and tilt, us."""

    us: tuple[int, int]
    power: float = 0.0
    changes: int = 0  # commands that altered the light
    rests_ns: int = 0  # its gimbal
    steady_ns: int = 0  # gimbal and light
    warm: float = 0.0  # share of what it may be
    at_ns: int = 0  # of that

    def steady(self, now_ns: int) -> bool:
        return now_ns >= self.steady_ns


def command(lamp: LampControl, power: float, us: tuple[int, int], now_ns: int) -> LampControl:
    """The lamp told to burn like that. A turn in the dark is no change of light."""
    if (power, us) == (lamp.power, lamp.us):
        return lamp
    travel_us = max(abs(to - at) for to, at in zip(us, lamp.us, strict=True))
    rests_ns = lamp.rests_ns
    if travel_us:
        rests_ns = max(rests_ns, now_ns) + round(travel_us / SLEW_US_PER_S * 1e9) + SERVO_NS
    if power == lamp.power == 0.0:
        return lamp._replace(us=us, rests_ns=rests_ns)
    steady_ns = max(now_ns + DARK_NS, rests_ns if power else 0)
    return lamp._replace(power=power, us=us, changes=lamp.changes + 1, rests_ns=rests_ns, steady_ns=steady_ns)


def warmed(lamp: LampControl, now_ns: int) -> LampControl:
    """The lamp some time later: it warms with its power and cools with what it is."""
    dt_s = (now_ns - lamp.at_ns) * 1e-9 if lamp.at_ns else 0.0
    ends = lamp.power * COOLS_S / WARMS_S
    # Not exp, whose last bit differs between processors; steps are short.
    share = min(dt_s / COOLS_S, 1.0)
    return lamp._replace(warm=lamp.warm + (ends - lamp.warm) * share, at_ns=now_ns)


def load(lamp: LampControl, telemetry: Telemetry | None) -> float:
    """How near it is to a limit, of heat or of the battery: 0 to 1, in hundredths."""
    empty = 0.0 if telemetry is None else (FULL_V - telemetry.battery_v) / (FULL_V - EMPTY_V)
    return round(min(max(lamp.warm / TOO_WARM, empty, 0.0), 1.0), 2)


def cannot(has: bool, lamp: LampControl, telemetry: Telemetry | None, silent: bool) -> Why:
    """Why it must not burn at all, for itself or for others; empty: it may. silent: the control module is."""
    if not has:
        return "no lamp"
    if telemetry is None or silent or not telemetry.armed or telemetry.ladder > 0:
        return "off"
    if telemetry.battery_v < EMPTY_V:
        return "battery"
    return "heat" if lamp.warm >= TOO_WARM else ""


# --- choice of lamps, and what it costs robots that lend ---
# Which lamps to ask for: the rule of allocate.py, and what it costs those who lend.
#
# A lamp that is warm, or whose robot's battery runs low, is asked for only if the sweep gains as much by it as by
# borrowed light at all: the rule is asked twice, without and with the loaded ones.

LOADED = 0.5  # of what it may be, or empty: from there on a lamp costs
THING_M = 0.05  # half of what a target is whose size nobody knows
NEAREST_M = 0.05  # of a target, before the camera


def scene_of(calibration: Calibration, eye: Eye, target: Target, target_m: Vector) -> Scene | None:
    """What is about to be measured; None: too near to be."""
    away = tuple(to - at for to, at in zip(target_m, eye.position_m, strict=True))
    distance_m = math.sqrt(sum(x * x for x in away))
    radius_m = target.radius_m or (0.5 * target.length_m if target.length_m else THING_M)
    skin_m = distance_m - radius_m
    if skin_m <= max(calibration.swept.u_inf_m, 0.0) + NEAREST_M:
        return None
    x, y, z = (part / distance_m for part in away)
    fit = calibration.swept
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
    own: str | None, scene: Scene | FrameScene, places_m: Mapping[str, Vector], free: set[str], lighting: Lighting
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


# --- where lamps point ---
# Where lamps are and how their gimbals turn. A lamp sits beside the camera's pivot, to its left on the body.

AHEAD_M = 1.0  # along the camera's axis: where a lamp aims while nobody knows where anything is
BEYOND_DEG = 3.0  # past the end of a gimbal's way, and the target is still in the flat middle of its beam


class Aim(NamedTuple):
    """The geometry of a lamp of the fleet."""

    body: Body  # with the lamp in the place of the camera
    surface_m: float

    def place_m(self, pose: Pose, level: Attitude) -> Vector:
        """Where the lamp is, world frame."""
        return camera_pose(pose, self.body, *level, 0.0, 0.0, self.surface_m).position_m

    def at(self, point_m: Vector, pose: Pose, level: Attitude) -> tuple[tuple[int, int], bool]:
        """Pulses, us, that aim it at a point of the world, or as near as its gimbal gets; and whether that is there."""
        pan, tilt = look_at(point_m, pose, self.body, *level, self.surface_m)
        limits = self.body.pan_limit_deg, self.body.tilt_limit_deg
        turned = [min(max(deg, low), high) for deg, (low, high) in zip((pan, tilt), limits, strict=True)]
        there = all(abs(to - deg) <= BEYOND_DEG for to, deg in zip(turned, (pan, tilt), strict=True))
        pan_us, tilt_us = (self.us(deg) for deg in turned)
        return (pan_us, tilt_us), there

    def deg(self, us: tuple[int, int]) -> tuple[float, float]:
        """Pan and tilt at these pulses."""
        pan, tilt = ((pulse - self.body.servo_centre_us) / self.body.servo_us_per_deg for pulse in us)
        return pan, tilt

    def us(self, deg: float) -> int:
        """The pulse of a servo of its gimbal that is turned so far, us."""
        pulse = round(self.body.servo_centre_us + self.body.servo_us_per_deg * deg)
        return min(max(pulse, LOWEST_US), HIGHEST_US)


def aim_of(fleet: Fleet, lighting: Lighting) -> Aim:
    x, y, z = fleet.body.camera_m
    return Aim(replace(fleet.body, camera_m=(x, y + lighting.beam.beside_m, z)), fleet.tank.surface_m)


def axis_of(eye: Eye) -> Vector:
    """Unit vector of the optical axis, world frame."""
    (_, _, x), (_, _, y), (_, _, z) = eye.rotation
    return x, y, z


def looked_at(eye: Eye, believed_m: Vector | None) -> Vector:
    """What the camera looks at: as far ahead of it as the target is believed to be."""
    ahead_m = AHEAD_M if believed_m is None else max(math.dist(believed_m, eye.position_m), 0.2)
    x, y, z = (at + ahead_m * way for at, way in zip(eye.position_m, axis_of(eye), strict=True))
    return x, y, z


def others(fleet: Fleet, me: str, situation: Situation) -> dict[str, tuple[Pose, Attitude]]:
    """Where the neighbours with lamps are: as they say, or where they are moored; level, for nobody hears otherwise."""
    found = {}
    said = None if situation.neighbours is None else {each.name: each for each in situation.neighbours}
    for name in fleet.robot[me].neighbours:
        robot = fleet.robot[name]
        if not robot.lamp:
            continue
        if said is None:
            found[name] = robot.pose, Attitude(robot.depth_m, 0.0, 0.0)
        elif (there := said.get(name)) is not None:
            found[name] = there.pose, Attitude(there.depth_m, 0.0, 0.0)
    return found
