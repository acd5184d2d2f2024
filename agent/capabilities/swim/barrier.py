"""The velocity that keeps a robot clear of others, of walls and of things: the safe one nearest to the wanted one.

For each thing to keep clear of, with u the unit vector from it to the robot and s the distance left to spare:

    u . v >= -c(s) + u . v_j / 2 ;   c(s) = min(1.0 s, (-a T + sqrt(a^2 T^2 + 2 a s)) / 2) for s > 0, 1.5 s else

so that of two robots that come towards each other, each with speed c, both can brake in time: after T, with a
(after Wang et al., arXiv 1609.00651). The nearest point of such half-planes is found one by one: where the best so
far breaks the next, the new best lies on its edge (Seidel 1991). Where no velocity is safe, all are moved back by as
little as leaves one, so that the worst is broken least (as van den Berg et al. 2011, "Reciprocal n-body collision
avoidance"): a robot in a crowd that gets unsure of its place stays where it is, and flees from none into another.

And the reference that a behaviour gives: where the robot shall be, and how fast it may be there.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

Planar = tuple[float, float]
Spread = tuple[float, float, float]  # covariance of x and y: xx xy yy, m^2

RINGS_M = 0.34  # between the centres of two robots whose thruster rings touch
MARGIN_M = 0.02  # for what no covariance knows of
SWIMS_M = 0.03  # the same of what swims or is swum to: braking is not as believed either
SIGMAS = 3.0
FLEES_M = 0.20  # at most, from what is not known; beyond that, one that is lost would push all others into walls
WALL_M = 0.20  # from a wall, and from the skin of a thing: a ring of 0.17 m and its margin
TARGET_M = 0.35
BRAKE_M_S2 = 0.5
DELAY_S = 0.35  # until a robot brakes: its step, its thrusters, and the age of what it heard
STOPS_S = 1.0  # without a word of it a robot is not expected to swim on for longer than this
NEAR_1_S, APART_1_S = 1.0, 1.5  # speed for each metre left, and for each metre too near
RIGHT = 0.5  # of the speed that is lost to a neighbour, to the right of it; one that waits beside a goal is 27 deg off
HALVINGS = 10  # of what the half-planes are moved back by, where nothing is safe: to a thousandth of it
PARALLEL = 1e-9
STILL: Planar = (0.0, 0.0)


class Disc(NamedTuple):
    """Something round to keep clear of."""

    at_m: Planar
    clear_m: float  # least distance between the centres, were all known exactly
    velocity_m_s: Planar = STILL
    spread_m2: Spread = (0.0, 0.0, 0.0)
    yields: bool = False  # it keeps clear of the robot as well, so that each has half of the way
    strays_m: float = 0.0  # how far from there it may be by now, for all that is known
    flees: bool = False  # an animal: it gives way to a robot that cannot


class HalfPlane(NamedTuple):
    """All velocities v with normal . v >= least."""

    normal: Planar
    least: float


def robot(at_m: Planar, velocity_m_s: Planar, spread_m2: Spread, age_s: float = 0.0, clear_m: float = RINGS_M) -> Disc:
    """A neighbour as it said that it is, so long ago.

    Where it is by now is less and less sure: it may have braked or turned as hard as it can. One that has long been
    silent is taken to rest where it was going.
    """
    (x, y), (vx, vy) = at_m, velocity_m_s
    on_s = min(age_s, STOPS_S)
    moves = velocity_m_s if age_s < STOPS_S else STILL
    place = x + on_s * vx, y + on_s * vy
    return Disc(place, clear_m, moves, spread_m2, yields=True, strays_m=0.5 * BRAKE_M_S2 * age_s * age_s)


def safe_velocity(
    wanted: Planar,
    at_m: Planar,
    spread_m2: Spread,
    tank_m: Sequence[float],
    things: Iterable[Disc] = (),
    robots: Iterable[Disc] = (),
) -> Planar:
    """The safe velocity nearest to the wanted one; where none is, one that keeps clear of all but animals; where none
    is, the least unsafe.

    at_m, spread_m2: of the robot itself; tank_m: length and breadth; things: stones, the target; robots: in the order
    of their names.
    """
    things = tuple(things)
    hard = [
        *walls(at_m, tank_m),
        *(clear_of(at_m, spread_m2, disc) for disc in things if not disc.flees),
        *(clear_of(at_m, spread_m2, disc) for disc in robots),
    ]
    soft = [clear_of(at_m, spread_m2, disc) for disc in things if disc.flees]
    return nearest([*hard, *soft], wanted) or nearest(hard, wanted) or _least_broken(hard, wanted)


def keep_right(wanted: Planar, at_m: Planar, spread_m2: Spread, robots: Iterable[Disc]) -> Planar:
    """The wanted velocity, drawn to the right of the neighbour that is most in its way.

    Two that want to pass each other would stop face to face. Where both keep to the right, both get by.
    """
    planes = (clear_of(at_m, spread_m2, disc) for disc in robots)
    ways = ((least - (u[0] * wanted[0] + u[1] * wanted[1]), u) for u, least in planes)
    short, (ux, uy) = max(ways, default=(0.0, STILL))
    return (wanted[0] - RIGHT * short * uy, wanted[1] + RIGHT * short * ux) if short > 0.0 else wanted


def nearest(planes: Sequence[HalfPlane], wanted: Planar) -> Planar | None:
    """The point of all half-planes that is nearest to the wanted one; None where they have none in common."""
    x, y = wanted
    for k, ((ux, uy), least) in enumerate(planes):
        if ux * x + uy * y >= least:
            continue
        along, lowest, highest = ux * wanted[1] - uy * wanted[0], -math.inf, math.inf
        for (px, py), other in planes[:k]:  # where the edge runs through the half-planes before
            slope, rest = ux * py - uy * px, other - least * (ux * px + uy * py)
            if abs(slope) < PARALLEL:
                if rest > 0.0:
                    return None
            elif slope > 0.0:
                lowest = max(lowest, rest / slope)
            else:
                highest = min(highest, rest / slope)
        if lowest > highest:
            return None
        along = min(max(along, lowest), highest)
        x, y = least * ux - along * uy, least * uy + along * ux
    return x, y


def _least_broken(planes: Sequence[HalfPlane], wanted: Planar) -> Planar:
    """The velocity by which the worst of half-planes without a common one is broken least."""
    none, some = 0.0, max(least for _, least in planes)  # moved back by so much they hold STILL
    best = STILL
    for _ in range(HALVINGS):
        back = 0.5 * (none + some)
        found = nearest([HalfPlane(u, least - back) for u, least in planes], wanted)
        if found is None:
            none = back
        else:
            some, best = back, found
    return best


def walls(at_m: Planar, tank_m: Sequence[float]) -> tuple[HalfPlane, HalfPlane, HalfPlane, HalfPlane]:
    (x, y), (length, breadth) = at_m, tank_m[:2]
    return (
        HalfPlane((1.0, 0.0), -APART_1_S * (x - WALL_M)),
        HalfPlane((-1.0, 0.0), -APART_1_S * (length - x - WALL_M)),
        HalfPlane((0.0, 1.0), -APART_1_S * (y - WALL_M)),
        HalfPlane((0.0, -1.0), -APART_1_S * (breadth - y - WALL_M)),
    )


def clear_of(at_m: Planar, spread_m2: Spread, disc: Disc) -> HalfPlane:
    x, y = at_m[0] - disc.at_m[0], at_m[1] - disc.at_m[1]
    distance_m = math.sqrt(x * x + y * y)
    ux, uy = (x / distance_m, y / distance_m) if distance_m > 0.0 else (1.0, 0.0)
    xx, xy, yy = (p + q for p, q in zip(spread_m2, disc.spread_m2, strict=True))
    sigma_m = math.sqrt(max(0.0, ux * ux * xx + 2.0 * ux * uy * xy + uy * uy * yy))
    free_m, unknown_m = distance_m - disc.clear_m - SWIMS_M, SIGMAS * sigma_m
    too_near_m = min(free_m - min(unknown_m, FLEES_M), 0.0)
    spare_m = max(free_m - unknown_m - disc.strays_m, too_near_m)  # a robot does not flee from where it only may be
    recedes = ux * disc.velocity_m_s[0] + uy * disc.velocity_m_s[1]
    return HalfPlane((ux, uy), -approach_m_s(spare_m) + (0.5 * recedes if disc.yields else recedes))


def approach_m_s(spare_m: float) -> float:
    """c(s): how fast each of two may come nearer; negative where they have to part."""
    if spare_m <= 0.0:
        return APART_1_S * spare_m
    delayed = BRAKE_M_S2 * DELAY_S
    return min(NEAR_1_S * spare_m, 0.5 * (math.sqrt(delayed * delayed + 2.0 * BRAKE_M_S2 * spare_m) - delayed))


# --- reference ---

FORCE_N, MOMENT_NM = 6.0, 0.8  # what is asked for at most
SPEED_M_S = 0.25
TURN_RAD_S = 1.0


class Reference(NamedTuple):
    """Where a robot shall be now, and how that moves; m and rad, world frame."""

    place_m: Planar
    yaw: float
    velocity_m_s: Planar = STILL
    acceleration_m_s2: Planar = STILL
    rate_rad_s: float = 0.0
    depth_m: float | None = None  # None: as before
    speed_m_s: float = SPEED_M_S  # at most, beside that of the reference
    most_m_s: float = math.inf  # what the behaviour asks to stay below, whatever the robot may
    turn_rad_s: float = TURN_RAD_S
    most_rad_s: float = math.inf  # likewise
    done: bool = False
    coast: bool = False  # without any force
