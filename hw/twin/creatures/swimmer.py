"""One creature: a fish that wanders, shies, hides behind stones and rests, or swims from point to point.

Its speed through the water, which takes it along, follows what it wants with a lag; who rests holds its place. Its
turning is an Ornstein-Uhlenbeck rate, with what it shies from on top. All figures of temper are assumed; the beat of
the tail is not: fish gain some 0.65 of their length with each (Bainbridge 1958; Videler, Fish Swimming, 1993), and beat
as wide at all but the lowest speeds.
"""

from __future__ import annotations

import math
from enum import Enum
from typing import NamedTuple

from agent.core.messages import Vector
from hw.twin.creatures.steering import SHY_M, Thing, Water, allowed, lee, nearest, pushes
from hw.twin.scene import Creature, generator

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
    """`attitude` after each `tick`. A seed and a name make one stream of chance, which nobody else draws from."""

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
