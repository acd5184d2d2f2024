"""How a robot moved since a key frame, from points that were seen on the tank's floor then and are seen there now.

With depth, level and gimbal known at either time, and x = y = psi = 0, the rays of a pair of slopes meet the floor at a
(then) and b (now), in the robot's upright frame of that time. What turns and shifts b onto a is how the robot moved:

    dpsi = atan2( sum(b x a), sum(b . a) ) of centred pairs ;  t = mean a - R(dpsi) mean b

Always from the key frame, never from the frame before: noise of the level (0.05 degrees is 1 mm on the floor) would
make each increment wrong, one after the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.kernel.messages import Vector
from agent.kernel.navigation.tags.projection import Theta, Upright, View, direction, upright

FARTHEST_M = 1.2  # of a point on the floor from the camera: beyond, level noise and slant make it worthless
FEWEST = 12  # pairs on the floor; half of them and more agree
ROUNDS = 4
STRAY = 3.0  # times the median residual: beyond it a point was mistaken for another
AGREE_M = 0.01  # median residual of points that lie on the floor: a pixel is 1 mm at a metre
STANDS_M = 0.002  # sigma of a robot that stays where it is: level noise of two frames
OF_WAY = 0.008  # and what of the way adds to it
TURN_RAD = math.radians(0.1)
LONGEST_M = 0.5  # new key frames are due every 0.25 m; what is farther than twice that is a mistake

Pair = tuple[float, float, float, float]  # slopes x, y then; x, y now
Point = tuple[float, float]


class Moved(NamedTuple):
    """The robot now, in the upright frame that it had at the key frame: z of pose_filter.add_flow."""

    pose: Vector  # x ahead and y to the left, m; yaw, rad
    sigma_m: float
    sigma_rad: float
    pairs: int  # that agreed


def odometry(of: View, then: Theta, now: Theta, pairs: Sequence[Pair]) -> Moved | None:
    """None where too few points are on the floor and agree.

    then, now: depth, level and gimbal at either exposure; their x, y and psi do not count.
    """
    eye_then, eye_now = upright(of, then), upright(of, now)
    met: list[tuple[Point, Point]] = []
    for x_then, y_then, x_now, y_now in pairs:
        a, b = on_floor(eye_then, (x_then, y_then)), on_floor(eye_now, (x_now, y_now))
        if a is not None and b is not None:
            met.append((a, b))
    if len(met) < FEWEST:
        return None
    kept, pose, median_m = met, _carry(met), 0.0
    for _ in range(ROUNDS):
        misses = [_miss(pose, a, b) for a, b in met]
        median_m = sorted(misses)[len(misses) // 2]
        kept = [pair for pair, miss in zip(met, misses, strict=True) if miss <= STRAY * median_m]
        pose = _carry(kept)
    way_m = math.hypot(pose[0], pose[1])
    if median_m > AGREE_M or way_m > LONGEST_M:
        return None
    return Moved(pose, math.hypot(STANDS_M, OF_WAY * way_m), TURN_RAD, len(kept))


def on_floor(eye: Upright, slope: Point) -> Point | None:
    """Where a ray meets the floor, in the robot's upright frame; None where that is far off, or never."""
    x, y, z = direction(eye, slope)
    length = math.sqrt(x * x + y * y + z * z)
    if not -z * FARTHEST_M > eye.height_m * length:
        return None
    along = eye.height_m / -z
    return eye.origin_m[0] + along * x, eye.origin_m[1] + along * y


def _carry(pairs: Sequence[tuple[Point, Point]]) -> Vector:
    """(x, y, dpsi) with a = R(dpsi) b + (x, y), by least squares."""
    n = len(pairs)
    ax = ay = bx = by = 0.0
    for (px, py), (qx, qy) in pairs:
        ax, ay, bx, by = ax + px, ay + py, bx + qx, by + qy
    ax, ay, bx, by = ax / n, ay / n, bx / n, by / n
    across = along = 0.0
    for (px, py), (qx, qy) in pairs:
        px, py, qx, qy = px - ax, py - ay, qx - bx, qy - by
        across += qx * py - qy * px
        along += qx * px + qy * py
    turn = math.atan2(across, along)
    c, s = math.cos(turn), math.sin(turn)
    return ax - (c * bx - s * by), ay - (s * bx + c * by), turn


def _miss(pose: Vector, a: Point, b: Point) -> float:
    c, s = math.cos(pose[2]), math.sin(pose[2])
    return math.hypot(a[0] - (c * b[0] - s * b[1] + pose[0]), a[1] - (s * b[0] + c * b[1] + pose[1]))
