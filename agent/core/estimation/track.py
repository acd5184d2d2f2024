"""A target that moves: Kalman filter of place and velocity, constant but for white acceleration.

State (x, v), covariance in blocks P = [[A, C], [C^T, D]] of 3x3; C is kept as its nine numbers, row by row.
Between samples, over dt: x += v dt and P grows by Q = q [[dt^3/3, dt^2/2], [dt^2/2, dt]] in each axis (Bar-Shalom,
Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.2.2); what turns, as
dynamics.py has it.

A correction takes any information Lam >= 0, such as a bearing's. Where Lam can well be inverted it is the textbook's,
by its inverse R; else, with N = (I + A Lam)^-1 and e = Lam (z - x): A' = N A, C' = N C, D' = D - C^T Lam C', x += A' e,
v += C'^T e, the same by the matrix inversion lemma.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from agent.core.estimation.dynamics import ROLLING, Dynamics, growth
from agent.core.matrix import IDENTITY, WELL, ZERO, adjugate, apply, invert, minus, plus, quadratic, times, trace
from agent.core.messages import Symmetric, Vector

Square = tuple[float, float, float, float, float, float, float, float, float]  # 3x3, row by row


class Track(NamedTuple):
    t_ns: int
    x_m: Vector
    v_m_s: Vector
    A: Symmetric  # m^2
    C: Square  # m^2/s
    D: Symmetric  # m^2/s^2


def begin(t_ns: int, information: Symmetric, vector: Vector, dynamics: Dynamics = ROLLING) -> Track:
    """A track from one first sample, (R^-1, R^-1 x̂), which must know every direction (line.placed)."""
    covariance = invert(information)
    return Track(
        t_ns,
        apply(covariance, vector),
        (0.0, 0.0, 0.0),
        covariance,
        (0.0,) * 9,
        times(dynamics.first_speed_m_s * dynamics.first_speed_m_s, dynamics.axes),
    )


def predict(track: Track, t_ns: int, dynamics: Dynamics = ROLLING) -> Track:
    """The track at a later time."""
    dt = (t_ns - track.t_ns) * 1e-9
    if dt <= 0.0:
        return track
    _, x, v, A, C, D = track
    if dynamics.turn_s < math.inf:
        return _turn(track, t_ns, dynamics)
    q = dynamics.psd_m2_s3
    both = (2.0 * C[0], C[1] + C[3], C[2] + C[6], 2.0 * C[4], C[5] + C[7], 2.0 * C[8])  # C + C^T
    A = plus(plus(A, times(dt, both)), plus(times(dt * dt, D), times(q * dt * dt * dt / 3.0, IDENTITY)))
    C = add_times(C, dt, square(plus(D, times(0.5 * q * dt, IDENTITY))))
    D = plus(D, times(q * dt, IDENTITY))
    return Track(t_ns, (x[0] + dt * v[0], x[1] + dt * v[1], x[2] + dt * v[2]), v, A, C, D)


def _turn(track: Track, t_ns: int, dynamics: Dynamics) -> Track:
    """As predict, of what keeps its velocity for a while."""
    before_ns, x, v, A, C, D = track
    a, e, place, both, speed = growth(dynamics, (t_ns - before_ns) * 1e-9)
    crossed = (2.0 * C[0], C[1] + C[3], C[2] + C[6], 2.0 * C[4], C[5] + C[7], 2.0 * C[8])  # C + C^T
    axes = dynamics.axes
    A = plus(plus(A, times(a, crossed)), plus(times(a * a, D), times(place, axes)))
    C = add_times(square(times(both, axes)), e, add_times(C, a, square(D)))
    D = plus(times(e * e, D), times(speed, axes))
    x = x[0] + a * v[0], x[1] + a * v[1], x[2] + a * v[2]
    return Track(t_ns, x, (e * v[0], e * v[1], e * v[2]), A, C, D)


def correct(track: Track, information: Symmetric, vector: Vector) -> Track:
    """The track after samples of the present moment, summed as information (R^-1, R^-1 x̂)."""
    t_ns, x, v, A, C, D = track
    adj, det = adjugate(information)
    third = trace(information) / 3.0
    if not det > WELL * third * third * third:
        return _correct_in_part(track, information, vector)
    R = times(1.0 / det, adj)
    z = apply(R, vector)
    r = (z[0] - x[0], z[1] - x[1], z[2] - x[2])
    W = square(invert(plus(A, R)))  # S^-1
    K = product(square(A), W)
    L = product(transpose(C), W)  # gain of the velocity
    dx, dv = image(K, r), image(L, r)
    return Track(
        t_ns,
        (x[0] + dx[0], x[1] + dx[1], x[2] + dx[2]),
        (v[0] + dv[0], v[1] + dv[1], v[2] + dv[2]),
        minus(A, symmetric_part(product(K, square(A)))),
        add_times(C, -1.0, product(K, C)),
        minus(D, symmetric_part(product(L, C))),
    )


def _correct_in_part(track: Track, information: Symmetric, vector: Vector) -> Track:
    """As correct, by information that may lack a direction."""
    t_ns, x, v, A, C, D = track
    Lam = square(information)
    N = _shrink(A, information)
    A, before, C = symmetric_part(product(N, square(A))), C, product(N, C)
    seen = apply(information, x)
    e = vector[0] - seen[0], vector[1] - seen[1], vector[2] - seen[2]
    dx, dv = apply(A, e), image(transpose(C), e)
    return Track(
        t_ns,
        (x[0] + dx[0], x[1] + dx[1], x[2] + dx[2]),
        (v[0] + dv[0], v[1] + dv[1], v[2] + dv[2]),
        A,
        C,
        minus(D, symmetric_part(product(transpose(before), product(Lam, C)))),
    )


def nis_of_bearing(track: Track, x_m: Vector, information: Symmetric) -> float:
    """The same of a bearing through x_m: chi^2 with as many degrees of freedom as its rank."""
    r = x_m[0] - track.x_m[0], x_m[1] - track.x_m[1], x_m[2] - track.x_m[2]
    S = product(square(information), _shrink(track.A, information))  # (A + R)^-1, where R may be without bound
    return quadratic(symmetric_part(S), r)


def _shrink(A: Symmetric, information: Symmetric) -> Square:
    """(I + A Lam)^-1"""
    a, b, c, d, e, f, g, h, i = add_times(square(IDENTITY), 1.0, product(square(A), square(information)))
    x, y, z = e * i - f * h, f * g - d * i, d * h - e * g
    k = 1.0 / (a * x + b * y + c * z)
    adj = (x, c * h - b * i, b * f - c * e, y, a * i - c * g, c * d - a * f, z, b * g - a * h, a * e - b * d)
    return add_times((0.0,) * 9, k, adj)


def nis(track: Track, x_m: Vector, covariance_m2: Symmetric) -> float:
    """Normalised innovation squared of a sample at the track's time: chi^2 with 3 degrees of freedom."""
    x = track.x_m
    return quadratic(invert(plus(track.A, covariance_m2)), (x_m[0] - x[0], x_m[1] - x[1], x_m[2] - x[2]))


def summed(samples: list[tuple[Symmetric, Vector]]) -> tuple[Symmetric, Vector]:
    """Sum of information pairs, of one moment or of one batch."""
    information, x, y, z = ZERO, 0.0, 0.0, 0.0
    for matrix, vector in samples:
        information = plus(information, matrix)
        x, y, z = x + vector[0], y + vector[1], z + vector[2]
    return information, (x, y, z)


def square(a: Symmetric) -> Square:
    xx, xy, xz, yy, yz, zz = a
    return xx, xy, xz, xy, yy, yz, xz, yz, zz


def symmetric_part(a: Square) -> Symmetric:
    return a[0], 0.5 * (a[1] + a[3]), 0.5 * (a[2] + a[6]), a[4], 0.5 * (a[5] + a[7]), a[8]


def transpose(a: Square) -> Square:
    return a[0], a[3], a[6], a[1], a[4], a[7], a[2], a[5], a[8]


def add_times(a: Square, k: float, b: Square) -> Square:
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = (p + k * q for p, q in zip(a, b, strict=True))
    return a0, a1, a2, a3, a4, a5, a6, a7, a8


def image(a: Square, v: Vector) -> Vector:
    x, y, z = v
    return a[0] * x + a[1] * y + a[2] * z, a[3] * x + a[4] * y + a[5] * z, a[6] * x + a[7] * y + a[8] * z


def product(a: Square, b: Square) -> Square:
    a0, a1, a2, a3, a4, a5, a6, a7, a8 = a
    b0, b1, b2, b3, b4, b5, b6, b7, b8 = b
    return (
        a0 * b0 + a1 * b3 + a2 * b6,
        a0 * b1 + a1 * b4 + a2 * b7,
        a0 * b2 + a1 * b5 + a2 * b8,
        a3 * b0 + a4 * b3 + a5 * b6,
        a3 * b1 + a4 * b4 + a5 * b7,
        a3 * b2 + a4 * b5 + a5 * b8,
        a6 * b0 + a7 * b3 + a8 * b6,
        a6 * b1 + a7 * b4 + a8 * b7,
        a6 * b2 + a7 * b5 + a8 * b8,
    )
