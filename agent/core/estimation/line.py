"""What a sample of rank 2 says: the target is on a line, so well across it, and nothing along it."""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.matrix import adjugate, apply, inverse, invert, plus, times, trace
from agent.core.messages import Symmetric, Vector

FLAT = 1e-9  # of the trace's square, sum of the principal minors: below this a second direction is not known either
ALONG = 1e-9  # of the trace, 1/m: what rounding leaves of a vector along the line


class Line(NamedTuple):
    """The points foot_m + s along."""

    foot_m: Vector
    along: Vector  # of length 1


def line(information: Symmetric, vector: Vector) -> Line | None:
    """The line of an information matrix without rank 3 and its vector; None where it leaves more than a line open, or
    where the vector claims to know the place along it."""
    adj, _ = adjugate(information)
    size = trace(information)
    if not trace(adj) > FLAT * size * size:
        return None
    # The adjugate of a matrix of rank 2 is that of its null direction, n n', times both eigenvalues.
    xx, xy, xz, yy, yz, zz = adj
    column = max(((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)), key=lambda c: c[0] * c[0] + c[1] * c[1] + c[2] * c[2])
    length = math.sqrt(column[0] * column[0] + column[1] * column[1] + column[2] * column[2])
    n = column[0] / length, column[1] / length, column[2] / length
    if abs(_dot(vector, n)) > ALONG * size:
        return None
    return Line(apply(invert(plus(information, times(size, outer(n)))), vector), n)


def chord(of: Line, low_m: Vector, high_m: Vector) -> tuple[float, float] | None:
    """From where to where along a line it is in a box; None: nowhere."""
    first, last = -math.inf, math.inf
    for x, n, low, high in zip(*of, low_m, high_m, strict=True):
        if n == 0.0:
            if not low <= x <= high:
                return None
            continue
        near, far = sorted(((low - x) / n, (high - x) / n))
        first, last = max(first, near), min(last, far)
    return (first, last) if first < last else None


def placed(information: Symmetric, vector: Vector, tank_m: Vector) -> tuple[Symmetric, Vector]:
    """The same, with what is known beforehand: that the target is in the tank. Of a line, that it is anywhere on its
    chord, which has the variance chord^2/12; of what hardly knows a direction, or two, anywhere in the box."""
    of = line(information, vector) if inverse(information) is None else None
    if of is None:
        x, y, z = (12.0 / (size * size) for size in tank_m)
        vx, vy, vz = (v + 6.0 / size for v, size in zip(vector, tank_m, strict=True))
        return plus(information, (x, 0.0, 0.0, y, 0.0, z)), (vx, vy, vz)
    ends = chord(of, (0.0, 0.0, 0.0), tank_m)
    if ends is None:  # a little outside: as far along as the tank's middle is, within the tank's diagonal
        half = 0.5 * math.sqrt(_dot(tank_m, tank_m))
        x, y, z = of.foot_m
        middle = _dot((0.5 * tank_m[0] - x, 0.5 * tank_m[1] - y, 0.5 * tank_m[2] - z), of.along)
        ends = middle - half, middle + half
    width, middle = ends[1] - ends[0], 0.5 * (ends[0] + ends[1])
    weight = 12.0 / (width * width)
    known = weight * (middle + _dot(of.foot_m, of.along))
    x, y, z = (v + known * n for v, n in zip(vector, of.along, strict=True))
    return plus(information, times(weight, outer(of.along))), (x, y, z)


def outer(n: Vector) -> Symmetric:
    """n n'"""
    x, y, z = n
    return x * x, x * y, x * z, y * y, y * z, z * z


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
