"""A target that moves: Kalman filter of place and velocity, constant but for white acceleration.

State (x, v), covariance in blocks P = [[A, C], [C^T, D]] of 3x3; C is kept as its nine numbers, row by row.
Between samples, over dt: x += v dt and P grows by Q = q [[dt^3/3, dt^2/2], [dt^2/2, dt]] in each axis (Bar-Shalom,
Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.2.2).
"""

from __future__ import annotations

from typing import NamedTuple

from agent.kernel.estimation.matrix import IDENTITY, ZERO, apply, invert, minus, plus, quadratic, times
from agent.kernel.messages import Symmetric, Vector

Square = tuple[float, float, float, float, float, float, float, float, float]  # 3x3, row by row

ACCELERATION_PSD = 4e-6  # q, m^2/s^3: a ball rolled by a swell changes its speed by 2 mm/s in a second
FIRST_SPEED_M_S = 0.05  # sigma of each component before any motion was seen


class Track(NamedTuple):
    t_ns: int
    x_m: Vector
    v_m_s: Vector
    A: Symmetric  # m^2
    C: Square  # m^2/s
    D: Symmetric  # m^2/s^2


def begin(t_ns: int, information: Symmetric, vector: Vector) -> Track:
    """A track from one first sample, (R^-1, R^-1 x̂)."""
    covariance = invert(information)
    return Track(
        t_ns,
        apply(covariance, vector),
        (0.0, 0.0, 0.0),
        covariance,
        (0.0,) * 9,
        times(FIRST_SPEED_M_S * FIRST_SPEED_M_S, IDENTITY),
    )


def predict(track: Track, t_ns: int) -> Track:
    """The track at a later time."""
    dt = (t_ns - track.t_ns) * 1e-9
    if dt <= 0.0:
        return track
    _, x, v, A, C, D = track
    q = ACCELERATION_PSD
    both = (2.0 * C[0], C[1] + C[3], C[2] + C[6], 2.0 * C[4], C[5] + C[7], 2.0 * C[8])  # C + C^T
    A = plus(plus(A, times(dt, both)), plus(times(dt * dt, D), times(q * dt * dt * dt / 3.0, IDENTITY)))
    C = add_times(C, dt, square(plus(D, times(0.5 * q * dt, IDENTITY))))
    D = plus(D, times(q * dt, IDENTITY))
    return Track(t_ns, (x[0] + dt * v[0], x[1] + dt * v[1], x[2] + dt * v[2]), v, A, C, D)


def correct(track: Track, information: Symmetric, vector: Vector) -> Track:
    """The track after samples of the present moment, summed as information (R^-1, R^-1 x̂)."""
    t_ns, x, v, A, C, D = track
    R = invert(information)
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


def nis(track: Track, x_m: Vector, covariance_m2: Symmetric) -> float:
    """Normalised innovation squared of a sample at the track's time: chi^2 with 3 degrees of freedom."""
    x = track.x_m
    return quadratic(invert(plus(track.A, covariance_m2)), (x_m[0] - x[0], x_m[1] - x[1], x_m[2] - x[2]))


def summed(samples: list[tuple[Symmetric, Vector]]) -> tuple[Symmetric, Vector]:
    """Sum of information pairs of one moment."""
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
