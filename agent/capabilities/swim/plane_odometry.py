"""How a robot moved since a key frame, from points of the tank's floor and walls that were seen then and are seen now.

Where the robot was at the key frame is known to millimetres, so each ray of then meets the floor or a wall at a known
point a. Now that point is seen in another direction. In the upright frame that the body had at the key frame, the robot
is at t, turned by dpsi, and sees a at

    q = R(dpsi)' (a - t) - o ;  bearing = atan2(q_y, q_x) + aside ;  elevation = atan2(q_z, |q_xy|) + above
    aside = -w tan(elevation) cos(u) ;  above = e + w sin(u)

u is how far the bearing is from the camera's. t, dpsi, e and w minimise the sum of squares, by Gauss-Newton. e and w
are by how much the camera looks too low and is rolled: noise of the level does that (0.05 degrees, which look like 6 mm
of way on a floor 1.2 m off), a body that heels as it is pushed, or a gimbal that settles. To a camera that looks down a
roll looks like a turn.

Some points lie on a thing that swims, maybe most of them. They agree with each other, but not with the motion that the
robot expects of itself. So the points that count are at first those near where that motion puts them, and then those
near where they themselves put all; how near goes by the best quarter of all points.

Always from the key frame, never from the frame before: increments would be wrong one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

from agent.capabilities.swim.projection import Theta, Upright, View, direction, upright
from agent.core.linear_algebra import backward, cholesky, forward, lower_inverse, wrap
from agent.core.messages import Symmetric, Vector

FARTHEST_M = 3.0  # of a point from the camera
FEWEST = 12  # points that agree
ROUNDS, SETTLED = 5, 1e-4  # m and rad: a tenth of what a point errs; the next step would be a hundredth of that
STRAY = 3.0  # times the median residual of the tank's points: beyond it a point was mistaken for another, or swims
MEDIAN = 1.55  # times the quarter's: the median of such residuals (Rayleigh's distribution)
SEEN_RAD = 0.0005  # sigma of a point's direction at least: half a pixel
AGREE_RAD = 0.004  # median residual of points that lie on floor and walls: four pixels
STANDS_M = 0.002  # sigma of a robot that stays where it is: level noise of two frames
OF_WAY = 0.008  # and what of the way adds to it
TURN_RAD = math.radians(0.05)
LEVEL_RAD = math.radians(0.07)  # sigma of e and of w: level noise of two frames
# What swims hides behind stones, which a camera that goes with it sees more of than of walls. Points on a thing half as
# far as the wall behind it, taken for points of the wall, make a turn of as much of the way aside.
THINGS_M, OF_THINGS = 1.4, 0.3  # such a wall; and the share of the way that is not known either
OTHER_M = 0.25  # of a robot: half of its length, and what both places may be wrong by
LONGEST_M = 0.5  # new key frames are due every 0.25 m; what is farther than twice that is a mistake

Planar = tuple[float, float]
Pair = tuple[float, float, float, float]  # slopes x, y then; x, y now
Box = tuple[float, float, float]  # length, breadth and depth of the water, m
Silence = Literal["too few", "contrary"]  # points there are; or none of their motions is the tank's


class Point(NamedTuple):
    """A point of floor or wall: where, in the upright frame of then, and in which direction it is seen now."""

    place_m: Vector
    bearing: float
    elevation: float


class Miss(NamedTuple):
    """A point as it is seen after a motion: by how much it is off, and what that depends on."""

    aside: float  # to the left of where it should be, rad
    above: float  # rad
    by_roll: Planar  # what 1 rad of w adds to either
    q: Vector  # the point from the camera, in the upright frame of now, m
    from_robot: Planar  # and from the robot
    rho: float  # |q_xy|
    far: float  # |q|


class Moved(NamedTuple):
    """The robot now, in the upright frame that it had at the key frame: z of pose_filter.add_flow."""

    pose: Vector  # x ahead and y to the left, m; yaw, rad
    covariance: Symmetric
    pairs: int  # that agreed


def odometry(
    of: View,
    then: Theta,
    now: Theta,
    pairs: Sequence[Pair],
    box_m: Box,
    unsettled: float,
    wake: float = 0.0,
    others_m: Sequence[Vector] = (),
) -> Moved | Silence:
    """How it moved, or why that is not known.

    then, now: at either exposure; place and yaw of then tell which wall a ray meets, those of now where to begin.
    unsettled: sigma of the angle that a gimbal which was not at rest may be off by, rad; wake: of what the level is off
    by as the robot swims. others_m: where other robots are, roughly; what is seen towards one of them may lie on it.
    """
    eye_then, eye_now = upright(of, then), upright(of, now)
    points = []
    for x_then, y_then, x_now, y_now in pairs:
        place_m = meets(eye_then, then, (x_then, y_then), box_m)
        if place_m is None:
            continue
        x, y, z = direction(eye_now, (x_now, y_now))
        if not _towards(eye_now, now, (x, y), others_m):
            points.append(Point(place_m, math.atan2(y, x), math.atan2(z, math.hypot(x, y))))
    if len(points) < FEWEST:
        return "too few"
    x, y, _ = direction(eye_now, (0.0, 0.0))
    axis, state, L = math.atan2(y, x), [*_between(then, now), 0.0, 0.0], None
    kept, off = _agree(eye_now, axis, state, points)
    lift = math.hypot(LEVEL_RAD, unsettled, wake)
    for _ in range(ROUNDS):
        H, g = _normal(state, kept, lift / max(off, SEEN_RAD))
        L = cholesky(H) if len(kept) >= FEWEST else None
        if L is None:
            return "contrary"
        step = backward(L, forward(L, g))
        state = [a + b for a, b in zip(state, step, strict=True)]
        kept, off = _agree(eye_now, axis, state, points)
        if max(map(abs, step)) < SETTLED:
            break
    way_m = math.hypot(state[0], state[1])
    if L is None or len(kept) < FEWEST or off > AGREE_RAD or way_m > LONGEST_M:
        return "contrary"
    C, s2 = lower_inverse(L), max(off, SEEN_RAD) ** 2
    m2, rad2 = STANDS_M * STANDS_M + (OF_WAY * way_m) ** 2, TURN_RAD * TURN_RAD + unsettled * unsettled
    covariance = s2 * C[0][0] + m2, s2 * C[0][1], s2 * C[0][2], s2 * C[1][1] + m2, s2 * C[1][2], s2 * C[2][2] + rad2
    return Moved((state[0], state[1], wrap(state[2])), covariance, len(kept))


def by_things(moved: Vector) -> Symmetric:
    """What may be mistaken of a way (x, y, yaw) from a key frame whose points lie on things, not on floor and walls."""
    way2 = moved[0] * moved[0] + moved[1] * moved[1]
    place2 = OF_THINGS * OF_THINGS * way2
    return place2, 0.0, 0.0, place2, 0.0, way2 / (THINGS_M * THINGS_M)


def meets(eye: Upright, at: Theta, slope: tuple[float, float], box_m: Box) -> Vector | None:
    """Where a ray meets floor or wall, in the robot's upright frame, heights above the floor; None where that is too
    far off, or the surface."""
    x, y, z = direction(eye, slope)
    right, back = eye.origin_m[0], eye.origin_m[1]
    reach = eye.height_m / -z if z < 0.0 else math.inf
    for where, way, length in zip(*_from_above(eye, at, (x, y)), box_m, strict=False):
        if way != 0.0:
            reach = min(reach, ((length if way > 0.0 else 0.0) - where) / way)
    up = eye.height_m + reach * z
    if not (0.0 < reach * math.sqrt(x * x + y * y + z * z) <= FARTHEST_M and up < box_m[2]):
        return None
    return right + reach * x, back + reach * y, up


def _from_above(eye: Upright, at: Theta, way: Planar) -> tuple[Planar, Planar]:
    """Where a ray begins and which way it goes, in the world, of one that goes that way in the robot's frame."""
    c, s = math.cos(at[2]), math.sin(at[2])
    (right, back), (x, y) = eye.origin_m[:2], way
    return (at[0] + c * right - s * back, at[1] + s * right + c * back), (c * x - s * y, s * x + c * y)


def _towards(eye: Upright, at: Theta, way: Planar, others_m: Sequence[Vector]) -> bool:
    """Whether a ray passes by one of them, as seen from above."""
    if not others_m:
        return False
    ((from_x, from_y), (way_x, way_y)), flat = _from_above(eye, at, way), math.hypot(*way)
    for other in others_m:
        u, v = other[0] - from_x, other[1] - from_y
        if u * way_x + v * way_y > 0.0 and abs(u * way_y - v * way_x) < OTHER_M * flat:
            return True
    return False


def _agree(eye: Upright, axis: float, state: Sequence[float], points: Sequence[Point]) -> tuple[list[Miss], float]:
    """What is seen of the points that are about where they should be after that motion, and their median residual.

    axis: the camera's bearing.
    """
    misses = [_miss(eye, axis, state, point) for point in points]
    sizes = [math.hypot(miss.aside, miss.above) for miss in misses]
    off = MEDIAN * sorted(sizes)[len(sizes) // 4]
    most = STRAY * max(off, SEEN_RAD)
    return [miss for miss, size in zip(misses, sizes, strict=True) if size <= most], off


def _between(then: Theta, now: Theta) -> Vector:
    """Pose of the second in the frame of the first."""
    c, s = math.cos(then[2]), math.sin(then[2])
    east, north = now[0] - then[0], now[1] - then[1]
    return c * east + s * north, c * north - s * east, wrap(now[2] - then[2])


def _miss(eye: Upright, axis: float, state: Sequence[float], point: Point) -> Miss:
    x, y, psi, e, w = state
    c, s = math.cos(psi), math.sin(psi)
    u, v = point.place_m[0] - x, point.place_m[1] - y
    a, b = c * u + s * v, c * v - s * u
    qx, qy, qz = a - eye.origin_m[0], b - eye.origin_m[1], point.place_m[2] - eye.height_m
    rho, bearing = math.hypot(qx, qy), math.atan2(qy, qx)
    far, off_axis = max(math.hypot(rho, qz), 1e-9), bearing - axis
    by_roll = -qz / far * math.cos(off_axis), math.sin(off_axis)
    aside = wrap(point.bearing - bearing) * rho / far - w * by_roll[0]
    above = point.elevation - math.atan2(qz, rho) - e - w * by_roll[1]
    return Miss(aside, above, by_roll, (qx, qy, qz), (a, b), max(rho, 1e-3), far)


def _normal(state: Sequence[float], seen: Sequence[Miss], lift: float) -> tuple[list[list[float]], list[float]]:
    """J' J and J' r over directions, and the prior of e and w, whose sigma is `lift` of a direction's."""
    c, s = math.cos(state[2]), math.sin(state[2])
    n, weight = len(state), 1.0 / (lift * lift)
    H = [[0.0] * n for _ in range(n)]
    H[3][3] = H[4][4] = weight
    g = [0.0, 0.0, 0.0, -state[3] * weight, -state[4] * weight]
    for aside, above, (aside_by_roll, above_by_roll), (qx, qy, qz), (a, b), rho, far in seen:
        bx, by = -qy / (rho * far), qx / (rho * far)  # of the bearing by q, times rho / far: of an angle
        ex, ey = -qz * qx / (far * far * rho), -qz * qy / (far * far * rho)  # of the elevation
        for row, miss in (
            ((-c * bx + s * by, -s * bx - c * by, b * bx - a * by, 0.0, aside_by_roll), aside),
            ((-c * ex + s * ey, -s * ex - c * ey, b * ex - a * ey, 1.0, above_by_roll), above),
        ):
            for i, (weighs, line) in enumerate(zip(row, H, strict=True)):
                if weighs:
                    g[i] += weighs * miss
                    for k in range(i + 1):
                        line[k] += weighs * row[k]
    return H, g
