"""A frame that shows the target gives a bearing: across the ray it is placed as well as the box, along it not at all.

E: two unit vectors across the ray; V = sigma^2 u^2 I + E' P E, with u the range that is believed, which sets the
weight alone, and P what the robot's own pose adds. Then Lam = E V^-1 E' is of rank 2, and Lam (o + s n) the same for
any s.

The ray's own direction n errs by sigma from frame to frame, and lines that all go through one camera then seem to meet
there: along the true direction n0, n0' Lam n0 is 2/u^2 on average, out of nothing, and N frames from one place would
know the range to u / sqrt(2 N). So E is taken across the direction in which the target is believed to be, as an
extended Kalman filter linearizes about its prediction; the ray's own counts where nothing is believed.
"""

from __future__ import annotations

import math

from agent.core.estimation.evidence_checks import R_FLOOR_M
from agent.core.estimation.interface import NOTHING, Bearing
from agent.core.estimation.line import outer
from agent.core.matrix import IDENTITY, apply, invert, minus, plus, times
from agent.core.messages import Symmetric, Vector

NEAR = math.cos(0.2)  # of ray and belief; with more between them a wrong range would misplace the ray


def bearing(
    origin_m: Vector,
    direction: Vector,
    range_m: float,
    sigma_rad: float,
    t_ns: int,
    pose_m2: Symmetric = NOTHING,
    range_sigma_m: float | None = None,
    believed: Vector | None = None,
) -> Bearing:
    """The bearing of a camera at origin_m along `direction`, world frame; its length does not matter.

    pose_m2: covariance of the place at that range by errors of the robot's own pose, with what their memory makes of
    them. range_sigma_m: of a range by size or focus; None: there is none. believed: direction from there in which the
    target is believed to be, for want of a range; None, or one far off: no matter. Raises ValueError without a
    direction or a range.
    """
    if not (any(direction) and range_m > 0.0):
        raise ValueError(f"a bearing needs a direction and a range, not {direction} and {range_m} m")
    n = unit(direction)
    x_m = origin_m[0] + range_m * n[0], origin_m[1] + range_m * n[1], origin_m[2] + range_m * n[2]
    own = max(sigma_rad * range_m, R_FLOOR_M) ** 2
    if range_sigma_m is not None:  # a place, as good across as along
        along = outer(n)
        placed_m2 = plus(times(own, minus(IDENTITY, along)), times(max(range_sigma_m, R_FLOOR_M) ** 2, along))
        return Bearing(x_m, invert(plus(placed_m2, pose_m2)), t_ns)
    if believed is not None and any(believed) and _dot(n, towards := unit(believed)) > NEAR:
        n = towards
    e, f = _across(n)
    pe, pf = apply(pose_m2, e), apply(pose_m2, f)
    a, b, d = own + _dot(e, pe), _dot(e, pf), own + _dot(f, pf)
    det = a * d - b * b
    information = plus(plus(times(d / det, outer(e)), times(a / det, outer(f))), times(-b / det, _both(e, f)))
    return Bearing(x_m, information, t_ns)


def ranged(
    line: Bearing,
    origin_m: Vector,
    direction: Vector,
    range_m: float,
    range_sigma_m: float,
    believed: Vector | None = None,
) -> Bearing:
    """The same line from origin_m, a bearing without a range, with what is known of its range: too little to place the
    target across by it, too much to be thrown away.

    It counts along the axis that the line says nothing about, so that many such lines from one place know no more of
    the range than is put in here. direction, believed: as for the bearing.
    """
    n = unit(direction)
    if believed is not None and any(believed) and _dot(n, towards := unit(believed)) > NEAR:
        n = towards
    x, y, z = line.x_m
    along_m = _dot((x - origin_m[0], y - origin_m[1], z - origin_m[2]), n)
    by_m = range_m - along_m
    information = plus(line.information, times(1.0 / max(range_sigma_m, R_FLOOR_M) ** 2, outer(n)))
    return Bearing((x + by_m * n[0], y + by_m * n[1], z + by_m * n[2]), information, line.t_ns)


def unit(v: Vector) -> Vector:
    """Of length 1; v is not 0."""
    length = math.sqrt(_dot(v, v))
    return v[0] / length, v[1] / length, v[2] / length


def _across(n: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors, at right angles to n and to each other."""
    x, y, z = n
    if abs(z) < 0.9:  # the first one is level
        level = math.sqrt(x * x + y * y)
        e = -y / level, x / level, 0.0
    else:
        upright = math.sqrt(y * y + z * z)
        e = 0.0, -z / upright, y / upright
    return e, (y * e[2] - z * e[1], z * e[0] - x * e[2], x * e[1] - y * e[0])


def _both(e: Vector, f: Vector) -> Symmetric:
    """e f' + f e'"""
    return (
        2.0 * e[0] * f[0],
        e[0] * f[1] + e[1] * f[0],
        e[0] * f[2] + e[2] * f[0],
        2.0 * e[1] * f[1],
        e[1] * f[2] + e[2] * f[1],
        2.0 * e[2] * f[2],
    )


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
