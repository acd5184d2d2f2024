"""The creatures of a scene: fish that wander, shy, hide behind stones and rest, or swim from point to point.

A creature's speed through the water, which carries it along, follows the speed that it wants with a lag; at rest it
holds its place. Its turning rate is an Ornstein-Uhlenbeck process, with what it shies from on top. All figures of
temper are assumed; the beat of the tail is not: fish gain some 0.65 of their length with each (Bainbridge 1958;
Videler, Fish Swimming, 1993), and beat as wide at all but the lowest speeds.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Sequence
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.core.config import ConfigError
from agent.core.messages import Vector
from hw.twin.optics.raycast import FISH_MATERIALS, Ellipsoid, Swimming
from hw.twin.physics.body import matrix, quaternion
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import Creature, Solid, generator

if TYPE_CHECKING:
    from hw.twin.optics.painter import Outline

# --- steering: what a creature shies from, and what it cannot swim through ---

SHY_M = 0.35  # distance at which it begins to shy from walls, floor, surface, stones and robots
SIDE, LEVEL = 0.52, 0.31  # lengths that its middle keeps from walls; from floor and surface, whatever its pitch
SKIN = 0.2  # lengths that its middle keeps from the surface of a stone


class Thing(NamedTuple):
    """An upright ellipsoid in the way: a stone, a ball, a robot."""

    centre_m: Vector
    radii_m: Vector


class Water(NamedTuple):
    """The water body from a corner on the floor, and what is in it."""

    size_m: Vector
    stones: Sequence[Thing] = ()
    robots: Sequence[Thing] = ()
    current_m_s: Vector = (0.0, 0.0, 0.0)  # everywhere the same


def pushes(place_m: Vector, length_m: float, water: Water) -> Vector:
    """The way to get away: each thing within SHY_M pushes straight off by up to 1, with the square of its nearness.

    In the middle third of a narrow tank walls do not push. Robots count from their middle, stones from their surface.
    """
    away = [0.0, 0.0, 0.0]
    for axis, (x, size) in enumerate(zip(place_m, water.size_m, strict=True)):
        margin = margin_m(axis, length_m)
        shy = max(min(SHY_M, size / 3), margin * 1.01)
        for sign, distance in ((1.0, x), (-1.0, size - x)):
            away[axis] += sign * _nearness(distance, margin, shy)
    for things, hulls in ((water.stones, False), (water.robots, True)):
        for thing in things:
            off, distance = _off(place_m, thing.centre_m)
            reach = 0.0 if hulls else _radius_towards(thing, off)
            least = max(thing.radii_m) if hulls else SKIN * length_m
            push = _nearness(distance - reach, least, SHY_M)
            for axis in range(3):
                away[axis] += push * off[axis]
    return away[0], away[1], away[2]


def allowed(place_m: Vector, length_m: float, water: Water) -> Vector:
    """The nearest place that is not in a stone, a robot or a wall."""
    for thing in (*water.stones, *water.robots):
        place_m = _out_of(place_m, thing, SKIN * length_m)
    inside = []
    for axis, (x, size) in enumerate(zip(place_m, water.size_m, strict=True)):
        margin = margin_m(axis, length_m)
        inside.append(min(max(x, margin), size - margin))
    return inside[0], inside[1], inside[2]


def lee(stone: Thing, watcher_m: Vector, length_m: float, water: Water) -> Vector:
    """The place right behind a stone, as seen from watcher_m."""
    dx, dy = stone.centre_m[0] - watcher_m[0], stone.centre_m[1] - watcher_m[1]
    far = math.hypot(dx, dy) or 1.0
    ux, uy = dx / far, dy / far
    reach_m = _radius_towards(stone, (ux, uy, 0.0)) + 1.2 * SKIN * length_m
    x, y, z = stone.centre_m
    return allowed((x + ux * reach_m, y + uy * reach_m, z), length_m, water)


def nearest(place_m: Vector, things: Iterable[Thing]) -> Thing | None:
    return min(things, key=lambda thing: math.dist(thing.centre_m, place_m), default=None)


def margin_m(axis: int, length_m: float) -> float:
    """What a creature's middle keeps from either wall, or from floor and surface."""
    return (SIDE if axis < 2 else LEVEL) * length_m


def _nearness(distance_m: float, least_m: float, shy_m: float) -> float:
    share = min(max((shy_m - distance_m) / (shy_m - least_m), 0.0), 1.0)
    return share * share


def _off(place_m: Vector, centre_m: Vector) -> tuple[Vector, float]:
    """The unit vector from a centre to a place, and how far it is."""
    x, y, z = (a - b for a, b in zip(place_m, centre_m, strict=True))
    distance = math.sqrt(x * x + y * y + z * z)
    return ((x / distance, y / distance, z / distance), distance) if distance > 0.0 else ((1.0, 0.0, 0.0), 0.0)


def _radius_towards(thing: Thing, off: Vector) -> float:
    return 1.0 / math.sqrt(sum((u / r) ** 2 for u, r in zip(off, thing.radii_m, strict=True)))


def _out_of(place_m: Vector, thing: Thing, skin_m: float) -> Vector:
    """Straight off the centre to the surface of the thing and its skin, where it is inside of that."""
    grown = Thing(thing.centre_m, (thing.radii_m[0] + skin_m, thing.radii_m[1] + skin_m, thing.radii_m[2] + skin_m))
    off, distance = _off(place_m, thing.centre_m)
    reach = _radius_towards(grown, off)
    if distance >= reach:
        return place_m
    x, y, z = (c + reach * u for c, u in zip(thing.centre_m, off, strict=True))
    return x, y, z


# --- one creature's motion ---

TURN_S, TURN_RAD_S = 1.5, 1.04  # of the turning rate: how soon it is another one, standard deviation
CLIMB_S, CLIMB_RAD = 3.0, 0.12  # the same of its pitch
MOST_RAD_S, STEEPEST_RAD = 4.0, 0.35
STEER_PER_S, SHYNESS = 4.0, 4.0  # turning rate per angle to go; weight of what pushes beside the way ahead
SPEED_LAG_S, STARTLED_LAG_S, PITCH_LAG_S = 0.4, 0.06, 0.5
CRUISE_S, REST_S, RETIRE_S = (5.0, 25.0), (2.0, 4.0), 15.0  # least and mean of what is beyond; after which it gives up
AT_M = 0.02  # from a spot: it is there
STRIDE, FULL_BEAT = 0.65, 0.5  # lengths gained with a beat; lengths a second from which on it beats as wide as it can


class Doing(Enum):
    CRUISE = "cruise"
    RETIRE = "retire"  # on the way to a hiding place
    REST = "rest"


class Attitude(NamedTuple):
    """Where a creature is and how it holds itself; angles run on, so that between two ticks lies their mean."""

    x_m: float  # of its middle
    y_m: float
    z_m: float
    heading_rad: float
    pitch_rad: float  # nose up is positive
    beat_rad: float  # phase of the wave along its body
    width: float  # of the wave, 1: as wide as it gets


class Swimmer:
    """`attitude` after each `tick`. A seed and a name make one random stream, of this creature alone."""

    def __init__(self, creature: Creature, seed: int, water: Water) -> None:
        self.length_m = creature.length_m
        self.doing = Doing.CRUISE
        self._cruise_m_s, self._course = creature.speed_m_s, () if creature.path == "wander" else creature.path
        self._rng = generator(seed, creature.name, "swims")
        start = creature.position_m or (self._course[0] if self._course else self._anywhere(water))
        heading = self._rng.uniform(-math.pi, math.pi)
        self._next = 0
        if self._course:
            self._next = 1 % len(self._course)
            heading = math.atan2(self._course[self._next][1] - start[1], self._course[self._next][0] - start[0])
        self.attitude = Attitude(*allowed(start, self.length_m, water), heading, 0.0, 0.0, 1.0)
        self._speed_m_s, self._turn_rad_s, self._climb_rad = self._cruise_m_s, 0.0, 0.0
        self._left_s = self._lasting(CRUISE_S)
        self._spot_m: Vector | None = None
        self._startled_s, self._flight_m_s = 0.0, 0.0

    def startle(self, speed_m_s: float, for_s: float) -> None:
        """Something frightens it: away at that speed, for so long."""
        self._startled_s, self._flight_m_s = for_s, speed_m_s
        self._begin(Doing.CRUISE)

    def tick(self, water: Water, dt_s: float) -> None:
        """Swim on by dt_s."""
        place_m: Vector = self.attitude[:3]
        robot = nearest(place_m, water.robots)
        if not self._course:
            self._choose(place_m, robot, water, dt_s)
        self._wander(dt_s)
        error_rad, pitch_rad, wanted_m_s = self._aim(place_m, robot, water)
        lag_s = SPEED_LAG_S
        if self._startled_s > 0.0:
            self._startled_s -= dt_s
            wanted_m_s, lag_s = self._flight_m_s, STARTLED_LAG_S
        self._speed_m_s += (wanted_m_s - self._speed_m_s) * -math.expm1(-dt_s / lag_s)
        self._move(error_rad, pitch_rad, water, dt_s)

    def _move(self, error_rad: float, pitch_rad: float, water: Water, dt_s: float) -> None:
        x, y, z, heading, pitch, beat, _ = self.attitude
        wandering = 0.0 if self._course or self.doing is not Doing.CRUISE else self._turn_rad_s
        turn_rad_s = min(max(wandering + STEER_PER_S * error_rad, -MOST_RAD_S), MOST_RAD_S)
        heading += turn_rad_s * dt_s
        pitch_rad = min(max(pitch_rad, -STEEPEST_RAD), STEEPEST_RAD)
        pitch += (pitch_rad - pitch) * -math.expm1(-dt_s / PITCH_LAG_S)
        speed_m_s, drift_m_s = self._speed_m_s, water.current_m_s
        if self.doing is Doing.REST:  # it swims as fast as the water, against it
            speed_m_s, drift_m_s = max(speed_m_s, math.hypot(*drift_m_s)), (0.0, 0.0, 0.0)
        way_m = self._speed_m_s * dt_s
        level_m = way_m * math.cos(pitch)
        by_m = (level_m * math.cos(heading), level_m * math.sin(heading), way_m * math.sin(pitch))
        dx, dy, dz = (own + drift * dt_s for own, drift in zip(by_m, drift_m_s, strict=True))
        to = (x + dx, y + dy, z + dz)
        beat += 2 * math.pi * speed_m_s * dt_s / (STRIDE * self.length_m)
        width = min(speed_m_s / (FULL_BEAT * self.length_m), 1.0)
        self.attitude = Attitude(*allowed(to, self.length_m, water), heading, pitch, beat, width)

    # --- what it wants --------------------------------------------------------------------------------------------

    def _choose(self, place_m: Vector, robot: Thing | None, water: Water, dt_s: float) -> None:
        """Whether to do something else from now on."""
        self._left_s -= dt_s
        crowded = robot is not None and math.dist(robot.centre_m, place_m) < SHY_M
        match self.doing:
            case Doing.CRUISE if self._left_s <= 0.0 and not crowded and self._startled_s <= 0.0:
                stone = nearest(place_m, water.stones)
                watcher_m = robot.centre_m if robot is not None else place_m
                self._spot_m = lee(stone, watcher_m, self.length_m, water) if stone is not None else None
                self._begin(Doing.RETIRE if stone is not None else Doing.REST)
            case Doing.RETIRE if self._spot_m is not None and math.dist(self._spot_m, place_m) < AT_M:
                self._begin(Doing.REST)
            case Doing.RETIRE | Doing.REST if self._left_s <= 0.0 or crowded:
                self._begin(Doing.CRUISE)

    def _begin(self, doing: Doing) -> None:
        self.doing = doing
        lasts = {Doing.CRUISE: CRUISE_S, Doing.REST: REST_S, Doing.RETIRE: (RETIRE_S, 0.0)}
        self._left_s = self._lasting(lasts[doing])

    def _aim(self, place_m: Vector, robot: Thing | None, water: Water) -> tuple[float, float, float]:
        """The angle to turn by, the pitch to have, and the speed."""
        heading = self.attitude.heading_rad
        if self._course:
            to_m = self._course[self._next]
            if math.dist(to_m, place_m) < self.length_m / 2:
                self._next = (self._next + 1) % len(self._course)
            return *self._towards(to_m, place_m), self._cruise_m_s
        if self.doing is Doing.RETIRE and self._spot_m is not None:
            return *self._towards(self._spot_m, place_m), min(self._cruise_m_s, 2.0 * math.dist(self._spot_m, place_m))
        if self.doing is Doing.REST:
            return 0.0, 0.0, 0.0
        ax, ay, az = pushes(place_m, self.length_m, water)
        if self._startled_s > 0.0 and robot is not None:
            off = math.atan2(place_m[1] - robot.centre_m[1], place_m[0] - robot.centre_m[0])
            ax, ay = ax + math.cos(off), ay + math.sin(off)
        course = math.atan2(math.sin(heading) + SHYNESS * ay, math.cos(heading) + SHYNESS * ax)
        return _wrap(course - heading), self._climb_rad + az, self._cruise_m_s

    def _towards(self, to_m: Vector, place_m: Vector) -> tuple[float, float]:
        dx, dy, dz = (a - b for a, b in zip(to_m, place_m, strict=True))
        return _wrap(math.atan2(dy, dx) - self.attitude.heading_rad), math.atan2(dz, math.hypot(dx, dy))

    # --- chance ---------------------------------------------------------------------------------------------------

    def _wander(self, dt_s: float) -> None:
        turn, climb = self._rng.standard_normal(2).tolist()
        self._turn_rad_s = _ornstein_uhlenbeck(self._turn_rad_s, turn, dt_s / TURN_S, TURN_RAD_S)
        self._climb_rad = _ornstein_uhlenbeck(self._climb_rad, climb, dt_s / CLIMB_S, CLIMB_RAD)

    def _lasting(self, least_and_mean_s: tuple[float, float]) -> float:
        least_s, mean_s = least_and_mean_s
        return least_s + float(self._rng.exponential(mean_s))

    def _anywhere(self, water: Water) -> Vector:
        x, y, z = (float(self._rng.uniform(0.3 * size, 0.7 * size)) for size in water.size_m)
        return x, y, z


def _ornstein_uhlenbeck(x: float, normal: float, step: float, sigma: float) -> float:
    """Exact, so that sigma holds whatever the step (in correlation times)."""
    kept = math.exp(-step)
    return kept * x + sigma * math.sqrt(1.0 - kept * kept) * normal


def _wrap(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2 * math.pi)


# --- all creatures of a scene ---

ROBOT_M = (0.17, 0.17, 0.12)  # what no creature swims through: a hull and its thrusters' rings
TICK_S = TICK_NS * 1e-9


class School:
    """Empty for a scene without creatures. Raises ConfigError for a creature that has no room in the water."""

    def __init__(self, creatures: Sequence[Creature], seed: int, size_m: Vector, solids: Sequence[Solid]) -> None:
        check_creatures(creatures, size_m)
        self.creatures = tuple(creatures)
        self._water = Water(size_m, _stones(solids))
        self._swimmers = {creature.name: Swimmer(creature, seed, self._water) for creature in creatures}

    def __bool__(self) -> bool:
        return bool(self.creatures)

    def tick(
        self, robots_m: NDArray[np.float64], solids: Sequence[Solid], current_m_s: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        """Swim on by 10 ms in water that flows. robots_m: (n, 3) centres."""
        robots = [Thing((x, y, z), ROBOT_M) for x, y, z in robots_m.tolist()]
        water = Water(self._water.size_m, _stones(solids), robots, current_m_s)
        for swimmer in self._swimmers.values():
            swimmer.tick(water, TICK_S)

    def startle(self, name: str, speed_m_s: float, for_s: float) -> None:
        self._swimmers[name].startle(speed_m_s, for_s)

    @property
    def attitudes(self) -> list[Attitude]:
        """Of each, in the order of the scene."""
        return [swimmer.attitude for swimmer in self._swimmers.values()]


def _stones(solids: Sequence[Solid]) -> list[Thing]:
    return [Thing(solid.position_m, solid.radii_m) for solid in solids]


def check_creatures(creatures: Sequence[Creature], size_m: Vector) -> None:
    """Raise ConfigError for one that has no room in the water, or no name of its own."""
    for creature in creatures:
        _check(creature, [each.name for each in creatures], size_m)


def _check(creature: Creature, names: Sequence[str], size_m: Vector) -> None:
    if names.count(creature.name) > 1:
        raise ConfigError(f"creatures of the scene: two are called '{creature.name}'; give each a name of its own")
    if creature.like not in (None, *names):
        there = ", ".join(names)
        raise ConfigError(
            f"creature '{creature.name}': the scene has no creature '{creature.like}'; name one of {there}"
        )
    margins_m = [margin_m(axis, creature.length_m) for axis in range(3)]
    if any(2 * margin > size for margin, size in zip(margins_m, size_m, strict=True)):
        raise ConfigError(
            f"creature '{creature.name}': no room for {creature.length_m} m in this water; make it shorter"
        )
    points = () if creature.path == "wander" else creature.path
    for point in (*points, *([creature.position_m] if creature.position_m else [])):
        if not all(m <= x <= size - m for m, x, size in zip(margins_m, point, size_m, strict=True)):
            lows = ", ".join(f"{m:.2f} to {size - m:.2f}" for m, size in zip(margins_m, size_m, strict=True))
            raise ConfigError(
                f"creature '{creature.name}': {list(point)} is too close to a wall, the floor or the surface; "
                f"keep x, y and z within {lows} m"
            )


# --- shape: ellipsoids along a midline that bends as a creature swims ---
#
# The midline's offset to the side at s, from nose (0) to tail (1), is (C1 s + C2 s^2) sin(k s - phase), one wave in a
# length, a tenth of the length wide at the tail (Barrett, Triantafyllou et al., J. Fluid Mech. 392, 1999, of a tuna).

C1, C2, WAVES = 0.02, 0.08, 1.0


class Part(NamedTuple):
    """An ellipsoid in shares of the length: where on the midline, half its length, width and height, how far up."""

    s: float
    long: float
    wide: float
    high: float
    up: float = 0.0


PARTS = (
    Part(0.12, 0.12, 0.050, 0.080),  # head
    Part(0.28, 0.17, 0.065, 0.120),
    Part(0.46, 0.18, 0.060, 0.115),
    Part(0.63, 0.15, 0.042, 0.080),
    Part(0.78, 0.11, 0.022, 0.045),
    Part(0.92, 0.08, 0.008, 0.120),  # tail fin
    Part(0.42, 0.13, 0.006, 0.050, up=0.12),  # back fin
)


def swimming(creature: Creature, attitude: Attitude, seed: int) -> Swimming:
    """The ellipsoids of a creature, world frame. Its pattern is its own, or that of the creature that it is `like`."""
    across_m, up_m = _pattern_m(seed, creature.like or creature.name)
    length_m, material = creature.length_m, FISH_MATERIALS[creature.colour]
    middle_m = np.array(attitude[:3])
    axes = np.asarray(matrix(quaternion(0.0, -attitude.pitch_rad, attitude.heading_rad)))
    parts = []
    for part in PARTS:
        ahead_m = (0.5 - part.s) * length_m
        side, slope = bend(part.s, attitude.beat_rad, attitude.width)
        centre_m = middle_m + axes @ np.array((ahead_m, side * length_m, part.up * length_m))
        radii_m = (part.long * length_m, part.wide * length_m, part.high * length_m)
        pattern_m = (across_m + ahead_m, up_m + part.up * length_m)
        parts.append(Ellipsoid(centre_m, axes @ _turned(slope), radii_m, material, pattern_m))
    return Swimming(creature.name, tuple(parts))


def bend(s: float, beat_rad: float, width: float) -> tuple[float, float]:
    """The midline's offset to the left at s, in lengths, and the angle (rad) by which it points to the left there."""
    wide, wider = width * (C1 * s + C2 * s * s), width * (C1 + 2 * C2 * s)
    k = 2 * math.pi * WAVES
    phase = k * s - beat_rad
    per_s = wider * math.sin(phase) + wide * k * math.cos(phase)
    return wide * math.sin(phase), math.atan(-per_s)  # s counts backwards


@lru_cache(maxsize=64)
def _pattern_m(seed: int, name: str) -> tuple[float, float]:
    """Which part of the texture a creature wears."""
    across_m, up_m = generator(seed, name, "pattern").uniform(0.0, 0.2, 2).tolist()
    return across_m, up_m


def _turned(angle_rad: float) -> NDArray[np.float64]:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))


# --- the truth about creatures: creatures.csv and, of each frame, boxes.csv ---
#
# Both are for the evaluation of a dive, as hw.twin.truth's files about robots are, never for an agent. They stay in the
# twin's folder until its next dive begins.

CREATURES, BOXES = "creatures.csv", "boxes.csv"
HEAD = "t_ns,creature,x_m,y_m,z_m,heading_rad,pitch_rad"
BOXES_HEAD = "t_ns,robot,frame,creature,x0,y0,x1,y1,pixels,visible"
FLUSH = 20  # looks, a second


class Lookout:
    """Writes where each creature is at each look, and what frames show of them. Cameras call from their own threads."""

    def __init__(self, creatures: Sequence[str], folder: Path) -> None:
        self._names, self._looks = list(creatures), 0
        self._paths = (folder / CREATURES).open("w", encoding="utf-8")
        self._boxes = (folder / BOXES).open("w", encoding="utf-8")
        self._paths.write(HEAD + "\n")
        self._boxes.write(BOXES_HEAD + "\n")
        self._lock = threading.Lock()

    def see(self, attitudes: Sequence[Attitude], t_ns: int) -> None:
        """Where the creatures are at t_ns, in the order of the scene."""
        with self._lock:
            if self._paths.closed:
                return
            for name, at in zip(self._names, attitudes, strict=True):
                self._paths.write(f"{t_ns},{name},{','.join(f'{number:.5f}' for number in at[:5])}\n")
            self._looks += 1
            if self._looks % FLUSH == 0:
                self._paths.flush()
                self._boxes.flush()

    def frame(self, robot: str, t_ns: int, number: int, shown: Sequence[Outline]) -> None:
        """What a robot's frame of that number shows, whose exposure had its middle at t_ns."""
        with self._lock:
            if self._boxes.closed:
                return
            for name, box, pixels, visible in shown:
                self._boxes.write(f"{t_ns},{robot},{number},{name},{','.join(map(str, box))},{pixels},{visible}\n")

    def close(self) -> None:
        with self._lock:
            self._paths.close()
            self._boxes.close()
