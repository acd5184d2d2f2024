"""A target that moves: Kalman filter of place and velocity, constant but for white acceleration.

State (x, v), covariance in blocks P = [[A, C], [C^T, D]] of 3x3; C is kept as its nine numbers, row by row.
Between samples, over dt: x += v dt and P grows by Q = q [[dt^3/3, dt^2/2], [dt^2/2, dt]] in each axis (Bar-Shalom,
Li and Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 6.2.2); a target that turns
follows the dynamics below.

A correction takes any information Lam >= 0, such as a bearing's. Where Lam can well be inverted it is the textbook's,
by its inverse R; else, with N = (I + A Lam)^-1 and e = Lam (z - x): A' = N A, C' = N C, D' = D - C^T Lam C', x += A' e,
v += C'^T e, the same by the matrix inversion lemma.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from agent.core.linear_algebra import (
    IDENTITY,
    WELL,
    ZERO,
    adjugate,
    apply,
    inner,
    inverse,
    invert,
    minus,
    plus,
    quadratic,
    times,
    trace,
    well_conditioned,
)
from agent.core.messages import Symmetric, Vector
from agent.core.step_transaction import Revertible

# --- dynamics ---
# How a target moves while it is not seen: a velocity that wanders, without bound or within one.
#
# In each axis dv = -v/T dt + sqrt(q) dW. Without T the velocity is a random walk, right for what rolls and drifts,
# whose speed an estimate may follow for long. An animal turns: with T, the time after which it has forgotten its
# course, its velocity stays near v_rms = sqrt(q T / 2), and so does what a track believes of it while no robot sees it:
# the integrated Ornstein-Uhlenbeck process (Uhlenbeck and Ornstein, Phys. Rev. 36, 1930), as Singer has it for the
# acceleration (IEEE Trans. AES-6, 1970).

# Of what swims, shares of its motion in each axis as variances: animals swim mostly level. Three tenths of the speed go
# up and down at most; the twin's fish do with half of that.
LEVEL: Symmetric = (1.0, 0.0, 0.0, 1.0, 0.0, 0.09)
SMALL = 0.01  # of h/T: below, differences of what is alike lose digits, and a series is exact to 1e-12


class Dynamics(NamedTuple):
    """Constants of one target."""

    psd_m2_s3: float  # q
    turn_s: float  # T; inf: never
    first_speed_m_s: float  # sigma of each component before any motion was seen

    @property
    def axes(self) -> Symmetric:
        """The factor of both variances in each axis."""
        return IDENTITY if self.turn_s == math.inf else LEVEL


class Growth(NamedTuple):
    """Over a step: x += reach_s v, v *= kept, and the covariances that each level axis gains."""

    reach_s: float
    kept: float
    place_m2: float
    both_m2_s: float
    speed_m2_s2: float


ROLLING = Dynamics(4e-6, math.inf, 0.05)  # a ball rolled by a swell changes its speed by 2 mm/s in a second


def swimming(speed_m_s: float, turn_s: float) -> Dynamics:
    """An animal of this speed, most of it level, that keeps a course for about turn_s: speed/sqrt(2) in x and in y."""
    v_rms_m_s = speed_m_s / math.sqrt(2.0)
    return Dynamics(2.0 * v_rms_m_s * v_rms_m_s / turn_s, turn_s, v_rms_m_s)


def growth(dynamics: Dynamics, h_s: float) -> Growth:
    """The growth over h_s; turn_s must be finite."""
    q, T, _ = dynamics
    x = h_s / T
    gone = -math.expm1(-x)  # 1 - e
    kept = 1.0 - gone
    place = _place(x) if x < SMALL else x - gone - 0.5 * gone * gone
    v2 = 0.5 * q * T  # v_rms^2
    return Growth(T * gone, kept, 2.0 * v2 * T * T * place, v2 * T * gone * gone, v2 * gone * (1.0 + kept))


def _place(x: float) -> float:
    """x - 2 (1 - e^-x) + (1 - e^-2x)/2, where it is small."""
    return x * x * x * (1 / 3 - x * (1 / 4 - x * (7 / 60 - x * (1 / 24 - x * 31 / 2520))))


# --- track ---

Square = tuple[float, float, float, float, float, float, float, float, float]  # 3x3, row by row


class Track(NamedTuple):
    """State of the filter at one time, world frame."""

    t_ns: int
    x_m: Vector
    v_m_s: Vector
    A: Symmetric  # m^2
    C: Square  # m^2/s
    D: Symmetric  # m^2/s^2


def begin(t_ns: int, information: Symmetric, vector: Vector, dynamics: Dynamics = ROLLING) -> Track:
    """A track from one first sample, (R^-1, R^-1 x̂), which must know every direction (`placed`)."""
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
    """As `predict`, for a target that keeps its velocity for a while."""
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
    """As `correct`, by information that may lack a direction."""
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
    """As `nis`, of a bearing through x_m: chi^2 with as many degrees of freedom as its rank."""
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


# --- line of a sample of rank 2 ---
# The sample says that the target is on a line: it places it well across the line, and not at all along it.

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
    if abs(inner(vector, n)) > ALONG * size:
        return None
    return Line(apply(invert(plus(information, times(size, outer(n)))), vector), n)


def chord(of: Line, low_m: Vector, high_m: Vector) -> tuple[float, float] | None:
    """Where along a line it enters and leaves a box; None: it does not pass through it."""
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
    """The same information, with what is known beforehand: that the target is in the tank. On a line it is anywhere on
    the chord, which has the variance chord^2/12; where one direction or two are hardly known, anywhere in the box."""
    of = line(information, vector) if inverse(information) is None else None
    if of is None:
        x, y, z = (12.0 / (size * size) for size in tank_m)
        vx, vy, vz = (v + 6.0 / size for v, size in zip(vector, tank_m, strict=True))
        return plus(information, (x, 0.0, 0.0, y, 0.0, z)), (vx, vy, vz)
    ends = chord(of, (0.0, 0.0, 0.0), tank_m)
    if ends is None:  # a little outside: as far along as the tank's middle is, within the tank's diagonal
        half = 0.5 * math.sqrt(inner(tank_m, tank_m))
        x, y, z = of.foot_m
        middle = inner((0.5 * tank_m[0] - x, 0.5 * tank_m[1] - y, 0.5 * tank_m[2] - z), of.along)
        ends = middle - half, middle + half
    width, middle = ends[1] - ends[0], 0.5 * (ends[0] + ends[1])
    weight = 12.0 / (width * width)
    known = weight * (middle + inner(of.foot_m, of.along))
    x, y, z = (v + known * n for v, n in zip(vector, of.along, strict=True))
    return plus(information, times(weight, outer(of.along))), (x, y, z)


def outer(n: Vector) -> Symmetric:
    """n n'"""
    x, y, z = n
    return x * x, x * y, x * z, y * y, y * z, z * z


# --- fixed-lag filter ---
# A Kalman filter over samples that come late and out of order: frozen where the window begins, run again from there.
#
# Its result is that of a filter that had every sample in time, as long as none is later than the window is long. What
# is older than the window stays as one track, whose weight fades with the acceleration noise.

ANYWHERE_M = (10.0, 10.0, 10.0)  # where the size of the tank is not given


class Held(NamedTuple):
    """One sample as this robot keeps it."""

    t_ns: int  # of exposure, on this robot's clock
    information: Symmetric  # R^-1, 1/m^2; of rank 2 at least
    vector: Vector  # R^-1 x̂, 1/m
    exposed_ns: int = 0  # of exposure, on the clock of its origin; 0: not told
    signature: bytes = b""
    unsure_ns: int = 0  # by which t_ns may be wrong: nobody knows exactly how long messages were on their way


class FixedLagFilter(Revertible):
    """A track over the samples that it is given; those up to the horizon it remembers, the others must be given again.

    tank_m: where the target is for certain, which is all that a first bearing knows of the way along it.
    """

    def __init__(self, dynamics: Dynamics = ROLLING, tank_m: Vector = ANYWHERE_M) -> None:
        self._dynamics, self._tank_m = dynamics, tank_m
        self._frozen: Track | None = None

    def run(self, samples: Iterable[Held], horizon_ns: int, now_ns: int) -> Track | None:
        """The track at this moment; None before the first sample.

        samples: all that are newer than the horizon of the run before, in an order that is the same on every robot.
        """
        moments: dict[int, list[tuple[Symmetric, Vector]]] = {}
        for held in samples:
            moments.setdefault(held.t_ns, []).append((held.information, held.vector))
        track = self._frozen
        for t_ns in sorted(moments):
            information, vector = summed(moments[t_ns])
            if track is None:
                if not well_conditioned(information):
                    information, vector = placed(information, vector, self._tank_m)
                track = begin(t_ns, information, vector, self._dynamics)
            else:
                track = correct(predict(track, t_ns, self._dynamics), information, vector)
            if t_ns <= horizon_ns:
                self._frozen = track
        return None if track is None else predict(track, now_ns, self._dynamics)
