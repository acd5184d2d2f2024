"""What a robot is told to do, as a reference for the pilot at every moment.

A behaviour starts with `start`, and is asked for its `reference` at each step. Yaw is counted from where the robot was
put into the water, over all turns, and kept within one turn either way: the tether would wind up.

First come the two behaviours that are longest, to follow a target and the trial; then all of them together.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.capabilities.swim.barrier import FORCE_N, MOMENT_NM, Planar, Reference
from agent.capabilities.swim.pose_filter import Belief, Hull, Wrench, damping, turn_damping
from agent.capabilities.swim.search import (
    Approach,
    Hunt,
    Surroundings,
    facing,
    known,
    search,
    sight_m,
    velocity_m_s,
    walled_in,
    within_walls,
)
from agent.core.config import Behaviour, Follow, Goto, Hold, Orbit, Search, Survey, Trial, Turn
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.core.target_state import TargetEstimate

# --- follow a target ---
# A robot keeps a distance from a target that may move: it decides on a place around it, how fast to go there, and
# which way to face.
#
# Each robot decides for itself. With th the bearing from the target to the robot, th_j that to another of the n that
# follow it, and g = wrap(th - th_j):
#
#     push = sum_j sgn(g) max(0, 0.9 * 2 pi / max(n, 3) - |g|)
#     goal = target + standoff (cos, sin)(th + push / 2 + d)
#     d of DETOURS with the least  |d| + 2 hidden + 5 reach / m + far / m + back
#
# drawn inside the walls; reach is what the wall takes from the distance, hidden whether another robot, or what hid
# the target lately, is in between, far by how much the wall behind the target is too far for its landmarks to be
# read, back whether it leads back from the side on which the robot goes round what hides the target. So robots part
# until they look from all sides, as agents in cyclic pursuit do (Marshall, Broucke and Francis, Formations of vehicles
# in cyclic pursuit, IEEE Trans. Automatic Control 49(11), 2004), though none knows of an order.
#
# The yaw leaves to the gimbal what it can reach, and turns along with the bearing: a gimbal turns in steps, and no
# sweep outlasts one.

SHARE = 0.9  # of an even spread: robots that want all of it push each other round for ever
DETOURS = (0.0, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2, 1.6, -1.6)  # rad, the first of equals is taken
ROUND = tuple(0.2 * k * sign for k in range(9) for sign in (1, -1))[1:]  # of what hides it: a gap may be narrow
HIDDEN, REACH_1_M = 2.0, 5.0  # what a detour may cost, rad; the first detour pays from 8 cm of reach on
FAR_M, FAR_1_M = 1.9, 1.0  # of the wall behind the target, where landmarks are, from the robot; rad for each metre more
BACK = 1.2  # rad: or a robot would go to and fro behind a stone
RING_M = 0.17  # of a robot, which hides what is behind it
ALONG = 0.7  # of the target's speed is swum ahead: it is known late, and turns
SURE_1_S = 0.5  # of the distance that is left where the target may be, swum in a second at most


class Pursuit(NamedTuple):
    """What is remembered between steps."""

    bearing: float  # of the target, from the robot, at the step before
    side: float = 0.0  # to which it goes round what hides the target: 1 anticlockwise, -1 clockwise, 0: nothing does


def knows(what: Follow, around: Surroundings, now_ns: int) -> bool:
    """Whether there is anything to follow: a robot saw it of late, and it is clear on which side it is."""
    target = around.target
    return target is not None and known(target, now_ns) and target.sigma_m < what.standoff_m


def follow(
    what: Follow,
    target: TargetEstimate,
    pursuit: Pursuit | None,
    yaw: float,
    pose: Vector,
    around: Surroundings,
    now_ns: int,
) -> tuple[Reference, Pursuit]:
    """Where the robot shall be now, of a target that it knows. yaw: that it held until now, rad."""
    at_m, velocity = target.x_m[:2], velocity_m_s(target, now_ns)
    swims = slowed((ALONG * velocity[0], ALONG * velocity[1]), around.speed_m_s)
    place, side = place_around(at_m, what.standoff_m, pose, around, 0.0 if pursuit is None else pursuit.side)
    most_m_s = max(min(around.speed_m_s - math.hypot(*swims), SURE_1_S * (what.standoff_m - target.sigma_m)), 0.0)
    bearing = math.atan2(at_m[1] - pose[1], at_m[0] - pose[0])
    to = Reference(
        place,
        wrap(facing(yaw if pursuit is None else yaw + wrap(bearing - pursuit.bearing), bearing)),
        swims,
        rate_rad_s=_rate(at_m, velocity, pose, around.velocity_m_s, what.standoff_m),
        most_m_s=most_m_s,
    )
    return to, Pursuit(bearing, side)


def place_around(
    target_m: Planar, standoff_m: float, pose: Vector, around: Surroundings, side: float = 0.0
) -> tuple[Planar, float]:
    """The goal, of the places around the target the one that costs least; and to which side it goes round what hid the
    target. side: to which it went until now."""
    mine = _bearing(target_m, (pose[0], pose[1]))
    middle = mine + 0.5 * _push(mine, [_bearing(target_m, other) for other in around.fellows_m])
    best, least, chosen = (pose[0], pose[1]), math.inf, 0.0
    for detour in ROUND if around.screens_m else DETOURS:
        way = math.cos(middle + detour), math.sin(middle + detour)
        goal = within_walls((target_m[0] + standoff_m * way[0], target_m[1] + standoff_m * way[1]), around.tank_m)
        reach_m = abs(math.dist(goal, target_m) - standoff_m)
        hidden = _hidden(goal, target_m, (*around.robots_m, *around.screens_m))
        far_m = max(sight_m(goal, _bearing(goal, target_m), around.tank_m) - FAR_M, 0.0)
        cost = abs(detour) + HIDDEN * hidden + REACH_1_M * reach_m + FAR_1_M * far_m + BACK * (detour * side < 0.0)
        if cost < least:
            best, least, chosen = goal, cost, detour
    if not around.screens_m:
        return best, 0.0
    return best, math.copysign(1.0, chosen) if chosen else side


def _push(mine: float, others: list[float]) -> float:
    """By how much the others' bearings are too near to this robot's, rad, and to which side."""
    even = SHARE * 2.0 * math.pi / max(len(others) + 1, 3)
    gaps = [wrap(mine - other) for other in others]
    return math.fsum(math.copysign(max(0.0, even - abs(gap)), gap) for gap in gaps)


def _hidden(from_m: Planar, target_m: Planar, things_m: tuple[Planar, ...]) -> bool:
    """Whether a robot, or what hid the target lately, is in between."""
    x, y = target_m[0] - from_m[0], target_m[1] - from_m[1]
    length2 = max(x * x + y * y, 1e-12)
    for other in things_m:
        east, north = other[0] - from_m[0], other[1] - from_m[1]
        along = (east * x + north * y) / length2
        if 0.0 < along < 1.0 and math.hypot(east - along * x, north - along * y) < RING_M:
            return True
    return False


def _rate(at_m: Planar, velocity: Planar, pose: Vector, own: Planar, standoff_m: float) -> float:
    """Of the bearing, rad/s; nearer than the standoff it may be anything."""
    x, y = at_m[0] - pose[0], at_m[1] - pose[1]
    way2 = max(x * x + y * y, standoff_m * standoff_m)
    return (x * (velocity[1] - own[1]) - y * (velocity[0] - own[0])) / way2


def _bearing(from_m: Planar, to_m: Planar) -> float:
    if from_m == to_m:
        return 0.0
    return math.atan2(to_m[1] - from_m[1], to_m[0] - from_m[0])


# --- trial for mass and drag ---
# A robot swims a trial so that its mass and drag can be read from the recording: two speeds, two turns, and coasts.
#
# Legs along a line, first ahead and astern, then sideways; then turns on the spot. Each leg is an approach, a run at
# one speed, and, from the middle on, a coast without any force: what slows it down then is drag alone.

TRIAL_NEAR_M, NEAR_RAD = 0.05, math.radians(5.0)  # of where a leg begins; a robot need not be there exactly
APPROACH_NS, RUN_NS, COAST_NS = 12_000_000_000, 9_000_000_000, 3_000_000_000  # at most; at most; always
QUARTER = 0.5 * math.pi  # of a turn, over which a turn runs


class Line(NamedTuple):
    """One leg along the line."""

    way: float  # 1: onwards, -1: back
    share: float  # of the trial's speed
    sideways: bool  # the hull across the line


class Spin(NamedTuple):
    """One leg on the spot."""

    rate_rad_s: float


def _lines(sideways: bool) -> tuple[Line, ...]:
    return tuple(Line(way, share, sideways) for way, share in ((1.0, 1.0), (-1.0, 0.4), (1.0, 0.4), (-1.0, 1.0)))


LEGS: tuple[Line | Spin, ...] = (*_lines(False), *_lines(True), Spin(0.4), Spin(-0.8), Spin(0.8), Spin(-0.4))


class Stage(NamedTuple):
    """How far a trial has come."""

    leg: int = 0
    coasts: bool = False
    runs: bool = False
    since_ns: int = 0
    yaw: float = 0.0  # at the start of a turn


def trial(what: Trial, stage: Stage, pose: Vector, most_m_s: float, now_ns: int) -> tuple[Reference, Stage]:
    """Where the robot shall be now; without legs left it stays in the middle, and is done."""
    stage = _next(what, stage, pose, now_ns)
    middle, heading = (what.x_m, what.y_m), math.radians(what.yaw_deg)
    if stage.leg >= len(LEGS):
        return Reference(middle, heading, done=True), stage
    leg = LEGS[stage.leg]
    if isinstance(leg, Spin):
        if not stage.runs:
            return Reference(middle, pose[2] if stage.coasts else heading, coast=stage.coasts), stage
        return Reference(middle, pose[2], rate_rad_s=leg.rate_rad_s), stage
    c, s = math.cos(heading), math.sin(heading)
    yaw = heading + (QUARTER if leg.sideways else 0.0)
    if not stage.runs and not stage.coasts:
        return Reference((what.x_m - leg.way * what.half_m * c, what.y_m - leg.way * what.half_m * s), yaw), stage
    along, v = _along(what, pose), leg.way * min(leg.share * what.speed_m_s, most_m_s)
    at = what.x_m + along * c, what.y_m + along * s  # abreast of the robot: it is late for nothing
    return Reference(at, yaw, (v * c, v * s), coast=stage.coasts), stage


def _next(what: Trial, stage: Stage, pose: Vector, now_ns: int) -> Stage:
    if stage.leg >= len(LEGS):
        return stage
    leg = LEGS[stage.leg]
    since_ns = now_ns if stage.since_ns == 0 else stage.since_ns
    stage, passed_ns = stage._replace(since_ns=since_ns), now_ns - since_ns
    if stage.coasts:
        return Stage(stage.leg + 1, since_ns=now_ns) if passed_ns >= COAST_NS else stage
    if stage.runs:
        over = _has_run(what, leg, stage, pose) or passed_ns >= RUN_NS
        return Stage(stage.leg, coasts=True, since_ns=now_ns) if over else stage
    ready = _is_ready(what, leg, pose) or passed_ns >= APPROACH_NS
    return Stage(stage.leg, runs=True, since_ns=now_ns, yaw=pose[2]) if ready else stage


def _has_run(what: Trial, leg: Line | Spin, stage: Stage, pose: Vector) -> bool:
    if isinstance(leg, Spin):
        turned = wrap(pose[2] - stage.yaw)
        return turned * leg.rate_rad_s > 0.0 and abs(turned) >= QUARTER
    return leg.way * _along(what, pose) >= 0.0


def _is_ready(what: Trial, leg: Line | Spin, pose: Vector) -> bool:
    way, yaw = (0.0, 0.0) if isinstance(leg, Spin) else (-leg.way * what.half_m, QUARTER if leg.sideways else 0.0)
    heading = math.radians(what.yaw_deg)
    x, y = what.x_m + way * math.cos(heading), what.y_m + way * math.sin(heading)
    return math.hypot(x - pose[0], y - pose[1]) < TRIAL_NEAR_M and abs(wrap(heading + yaw - pose[2])) < NEAR_RAD


def _along(what: Trial, pose: Vector) -> float:
    """How far the robot is along the line, from the middle."""
    heading = math.radians(what.yaw_deg)
    return (pose[0] - what.x_m) * math.cos(heading) + (pose[1] - what.y_m) * math.sin(heading)


# --- all behaviours ---

THERE_M, THERE_RAD, THERE_NS = 0.02, math.radians(2.0), 1_000_000_000  # arrived: so near, for so long
NEAR_M = 0.10  # to the goal: the way has no direction any more
MOST_TURNED_RAD = 2.0 * math.pi  # either way
SLACK_RAD = math.radians(10.0)  # an orbit turns round so far before that, for the body lags and swings
ON_ORBIT = 0.8  # of what it may swim at: the rest brings it back to the circle
ELSEWHERE_NS = 500_000_000  # several steps in which something else had the body: that time does not count
STRIDE_RAD = math.radians(90.0)  # of a reference ahead of the body: which way round stays clear


class Progress(NamedTuple):
    """What a behaviour remembers between steps."""

    asked_ns: int  # at the step before
    from_m: Planar  # where it started, or what it holds
    yaw: float  # to keep where the behaviour says nothing of yaw, rad
    turned: float  # by how much the body is turned since it was put into the water, rad, over all turns
    heading: float  # the yaw that `turned` was last counted at
    turned_first: float  # `turned` at the start
    there_ns: int | None = None  # since when it is where it shall be
    way: float = 0.0  # along an orbit, rad
    approach: Approach = Approach()  # to the place of Goto
    stage: Stage = Stage()  # of a trial
    pursuit: Pursuit | None = None  # of a target that is followed
    hunt: Hunt = Hunt()  # for a target that is not known


def start(pose: Vector, turned: float, now_ns: int, to: Vector | None = None) -> Progress:
    """pose: x, y, yaw, and what Hold holds, unless that is given: `to`. turned: of the behaviour before
    (Progress.turned), 0 for the first."""
    x, y, yaw = pose if to is None else to
    return Progress(now_ns, (x, y), yaw, turned, pose[2], turned)


def reference(
    what: Behaviour,
    progress: Progress,
    pose: Vector,
    now_ns: int,
    around: Surroundings,
    watched_m: Planar | None = None,
) -> tuple[Reference, Progress]:
    """Where the robot shall be now. watched_m: the target, which Goto faces unless it was given a yaw. Hold turns off
    its yaw as far as the gimbal needs, to keep the target in sight: the gimbal first, then the body. A robot that is
    free to choose its yaw looks at no near wall.
    """
    turned, passed_ns = progress.turned + wrap(pose[2] - progress.heading), now_ns - progress.asked_ns
    passed_ns = passed_ns if passed_ns < ELSEWHERE_NS else 0
    progress = progress._replace(turned=turned, heading=pose[2], asked_ns=now_ns)
    match what:
        case Hold():
            to = Reference(progress.from_m, in_sight(progress.yaw, pose, watched_m))
        case Turn():
            to = Reference(progress.from_m, math.radians(what.yaw_deg))
        case Goto():
            progress = progress._replace(yaw=_yaw_of_way(what, progress, pose, watched_m, around.tank_m))
            to = Reference((what.x_m, what.y_m), progress.yaw, depth_m=what.depth_m)
            off_m = math.dist(to.place_m, pose[:2])
            approach = Approach() if off_m < NEAR_M else progress.approach.at(off_m, passed_ns)
            progress = progress._replace(approach=approach)
        case Orbit():
            to, way = _on_orbit(what, progress, around.speed_m_s, passed_ns)
            progress = progress._replace(way=way)
        case Trial():
            to, stage = trial(what, progress.stage, pose, around.speed_m_s, now_ns)
            progress = progress._replace(stage=stage)
        case Survey():
            if around.station is not None:
                progress = progress._replace(from_m=around.station[0], yaw=around.station[1])
            to = Reference(progress.from_m, progress.yaw)
        case Follow() | Search():
            to, progress = _about_a_target(what, progress, pose, around, now_ns, passed_ns)
    there_ns = _there_since(to, progress, pose, now_ns) if isinstance(what, Goto | Turn) else None
    done = to.done or (there_ns is not None and now_ns - there_ns >= THERE_NS)
    return to._replace(yaw=unwound(to.yaw, pose[2], turned), done=done), progress._replace(there_ns=there_ns)


def effective(what: Behaviour, hunt: Hunt, around: Surroundings, now_ns: int) -> Behaviour:
    """What is in effect: Follow searches for a target that no robot knows, where it is told to, and else holds; Search
    holds once it is done."""
    if isinstance(what, Follow) and not knows(what, around, now_ns):
        what = Search(target=what.target) if what.search else Hold()
    if isinstance(what, Search) and hunt.over(around, now_ns):
        return Hold()
    return what


def _about_a_target(
    what: Follow | Search, progress: Progress, pose: Vector, around: Surroundings, now_ns: int, passed_ns: int
) -> tuple[Reference, Progress]:
    match effective(what, progress.hunt, around, now_ns):
        case Follow() as told if around.target is not None:
            target = around.target
            to, pursuit = follow(told, target, progress.pursuit, progress.yaw, pose, around, now_ns)
            return to, progress._replace(from_m=pose[:2], yaw=to.yaw, pursuit=pursuit, hunt=Hunt())
        case Search() as told:
            to, hunt = search(told, progress.hunt, progress.yaw, pose, around, now_ns, passed_ns)
            return to, progress._replace(from_m=pose[:2], yaw=to.yaw, pursuit=None, hunt=hunt)
    hunt = progress.hunt._replace(done=isinstance(what, Search))
    at_m = None if around.target is None else around.target.x_m[:2]
    to = Reference(progress.from_m, in_sight(progress.yaw, pose, at_m), done=hunt.done)
    return to, progress._replace(pursuit=None, hunt=hunt)


def unwound(wanted: float, yaw: float, turned: float) -> float:
    """A yaw to steer for: the wanted one; where the short way there would wind the tether up, one on the long way."""
    short = wrap(wanted - yaw)
    if abs(turned + short) <= MOST_TURNED_RAD:
        return wanted
    return wrap(yaw - math.copysign(min(STRIDE_RAD, 2.0 * math.pi - abs(short)), short))


def in_sight(yaw: float, pose: Vector, watched_m: Planar | None) -> float:
    """The yaw nearest to the wanted one from which the gimbal reaches the target."""
    if watched_m is None:
        return yaw
    return facing(yaw, math.atan2(watched_m[1] - pose[1], watched_m[0] - pose[0]))


def _yaw_of_way(what: Goto, progress: Progress, pose: Vector, watched_m: Planar | None, tank_m: Planar) -> float:
    if what.yaw_deg is not None:
        return math.radians(what.yaw_deg)
    if watched_m is not None:
        return math.atan2(watched_m[1] - pose[1], watched_m[0] - pose[0])
    x, y = what.x_m - pose[0], what.y_m - pose[1]
    yaw = math.atan2(y, x) if math.hypot(x, y) > NEAR_M else progress.yaw
    if not walled_in(pose[:2], yaw, tank_m) and not walled_in((what.x_m, what.y_m), yaw, tank_m):
        return yaw
    return math.atan2(0.5 * tank_m[1] - pose[1], 0.5 * tank_m[0] - pose[0])


def _on_orbit(what: Orbit, progress: Progress, most_m_s: float, passed_ns: int) -> tuple[Reference, float]:
    """p = c + R (cos th, sin th), th growing by V / R; back again where the tether has had its turn. And the way."""
    east, north = progress.from_m[0] - what.x_m, progress.from_m[1] - what.y_m
    first = math.atan2(north, east)
    facing = progress.turned_first + wrap(first + math.pi - progress.yaw)  # turned by so much, once it looks inwards
    if abs(facing) > MOST_TURNED_RAD:  # it has come there on the long way
        facing -= math.copysign(2.0 * math.pi, facing)
    speed_m_s = math.copysign(min(abs(what.speed_m_s), ON_ORBIT * most_m_s), what.speed_m_s)
    most, swum = MOST_TURNED_RAD - SLACK_RAD, progress.way + speed_m_s / what.radius_m * passed_ns * 1e-9
    way, sign = _to_and_fro(swum, -most - facing, most - facing)
    c, s = math.cos(first + way), math.sin(first + way)
    v, pull = sign * speed_m_s, speed_m_s * speed_m_s / what.radius_m
    to = Reference(
        (what.x_m + what.radius_m * c, what.y_m + what.radius_m * s),
        wrap(first + way + math.pi),
        (-v * s, v * c),
        (-pull * c, -pull * s),
        v / what.radius_m,
    )
    return to, swum


def _to_and_fro(way: float, lowest: float, highest: float) -> tuple[float, float]:
    """Where a robot is after a way from 0 with turns at both ends, and whether it goes as it set out: +1, else -1."""
    if lowest <= way <= highest:
        return way, 1.0
    span = highest - lowest
    along = math.fmod(way - lowest, 2.0 * span)
    along += 2.0 * span if along < 0.0 else 0.0
    return (lowest + along, 1.0) if along <= span else (highest - (along - span), -1.0)


def _there_since(to: Reference, progress: Progress, pose: Vector, now_ns: int) -> int | None:
    off_m = math.hypot(to.place_m[0] - pose[0], to.place_m[1] - pose[1])
    if off_m > THERE_M or abs(wrap(to.yaw - pose[2])) > THERE_RAD:
        return None
    return now_ns if progress.there_ns is None else progress.there_ns


# As stiff as is damped by 0.3 and more where thrusters lag by 0.08 to 0.15 s, mass and inertia are 0.75 to 1.3 times
# what is believed and fixes are 0.2 s late. At 3.0 the lightest and fastest body with the latest fixes swings for ever;
# so does its yaw at 1.3 times 2.5 (planar).
# --- pilot ---
# Force and moment that bring a robot to its reference, and the velocity that keeps it clear of others on the way.
#
# Control of velocity runs within control of place; `keep_right` and `safe_velocity` alter v_d between the two:
#
#     v_d = sat(k_p (p_ref - p), v_max) + v_ref ;  k_p = w / (2 z), k_v = 2 z w
#     F = M R(psi + r tau)' (a_ref + k_v (v_d - v) + k v - d)                yaw when the thrust acts
#     r_d = sat(w_psi / (2 z) e_psi, r_max) + r_ref ;  N = (J (2 z w_psi (r_d - r) + k_r r - d_psi) + munk) / (1 + gain)
#     u = f + 1.4 (F - f), within limits
#
# There is no integrator, and nothing that could wind up: d, Munk's moment and the gain are learnt from the force that
# was sent, after the limits.

W_RAD_S = 2.8
YAW_W_RAD_S = 2.5
Z = 0.9
LEAD = 1.4  # hurries the thrusters' lag; more makes noise of it


def wanted_velocity(belief: Belief, to: Reference) -> Planar:
    """v_d, before the barrier."""
    gain = W_RAD_S / (2.0 * Z)
    off = gain * (to.place_m[0] - belief.x[0]), gain * (to.place_m[1] - belief.x[1])
    x, y = slowed(off, to.speed_m_s)
    return x + to.velocity_m_s[0], y + to.velocity_m_s[1]


def slowed(velocity_m_s: Planar, most_m_s: float) -> Planar:
    """That way, at most so fast."""
    x, y = velocity_m_s
    speed = math.sqrt(x * x + y * y)
    return velocity_m_s if speed <= most_m_s else (x * most_m_s / speed, y * most_m_s / speed)


def wrench(belief: Belief, hull: Hull, to: Reference, velocity_m_s: Planar) -> Wrench:
    """What to ask the thrusters for, body frame: N ahead, N left, N m. velocity_m_s: v_d after the barrier.

    belief: at the time when it is sent.
    """
    _, _, psi, vx, vy, r, dx, dy, dpsi, munk_kg, gain = belief.x[:11]
    k = damping(hull, math.sqrt(vx * vx + vy * vy))
    stiff = 2.0 * Z * W_RAD_S
    px = hull.mass_kg * (to.acceleration_m_s2[0] + stiff * (velocity_m_s[0] - vx) + k * vx - dx)
    py = hull.mass_kg * (to.acceleration_m_s2[1] + stiff * (velocity_m_s[1] - vy) + k * vy - dy)
    c, s = math.cos(psi), math.sin(psi)
    munk = munk_kg * (c * vx + s * vy) * (c * vy - s * vx)
    c, s = math.cos(psi + r * hull.lag_s), math.sin(psi + r * hull.lag_s)
    turn = YAW_W_RAD_S / (2.0 * Z) * wrap(to.yaw - psi)
    rate = min(max(turn, -to.turn_rad_s), to.turn_rad_s) + to.rate_rad_s
    moment = hull.inertia_kgm2 * (2.0 * Z * YAW_W_RAD_S * (rate - r) + turn_damping(hull, r) * r - dpsi)
    moment = (moment + munk) / (1.0 + gain)
    ahead, left, round_ = (
        f + LEAD * (wish - f) for f, wish in zip(belief.force, (c * px + s * py, c * py - s * px, moment), strict=True)
    )
    size = math.sqrt(ahead * ahead + left * left)
    share = FORCE_N / size if size > FORCE_N else 1.0
    return share * ahead, share * left, min(max(round_, -MOMENT_NM), MOMENT_NM)
