"""Where a robot is and how it moves: an extended Kalman filter, driven by the forces that were asked for.

State (x, y, psi, v_x, v_y, r, d_x, d_y, d_psi), what is learnt of the body and stays (by how many kg its added mass is
larger aside than ahead, by what share its yaw moment is larger than was asked), the bias of the yaw rate where there is
a gyro, and, once there is a key frame, the (x, y, psi) that the robot had when it was exposed: its clone, which what is
seen since is measured from (Mourikis et al. 2007, stochastic cloning). A filter that is to be aided (aid.py) has the
place (x, y, z) of a target at rest before the clone, from the first sighting on. Lengths m, angles rad. Covariances of
what fluctuates: what survey and zeros have wrong in every fix alike, `stays`, is added once by whoever uses the pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.capabilities.swim.body_model import (
    STEP_NS,
    TETHER_N,
    TETHER_NM,
    ZERO_N,
    ZERO_NM,
    Hull,
    Motion,
    Wrench,
    motion,
)
from agent.core.linear_algebra import ZERO, Rows, wrap
from agent.core.messages import Symmetric, Vector

FIRST_BIAS_RAD_S = math.radians(0.6)
# Variances of v, r and d before anything was learnt: who was lost swims on for a while, and spins.
FIRST = (2e-2, 2e-2, 2.5e-1, 4e-3, 4e-3, 1e-1)
# Of what stays: Munk's difference of added masses, kg^2, and by how much a yaw moment is larger than what was asked.
FIRST_LEARNT = (0.8 * 0.8, 0.2 * 0.2)
MUNK, GAIN, BIAS = 9, 10, 11  # where they are in the state

State = tuple[float, ...]
Covariance = tuple[tuple[float, ...], ...]


class Drift(NamedTuple):
    """Noise that drives the filter, per root Hz."""

    speed: float = 0.005  # m/s, of a robot at rest
    rate: float = 0.015  # rad/s
    push: float = 0.014  # m/s^3: a tether that pulls by 0.15 N for 4 s
    twist: float = 0.02  # rad/s^3
    bias: float = 2e-5  # rad/s
    doubt_s: float = 1.0  # what the model has wrong of an acceleration (Motion.doubt) is white over so long


class Belief(NamedTuple):
    """The filter at one moment."""

    t_ns: int
    x: State
    P: Covariance
    force: Wrench = (0.0, 0.0, 0.0)  # acting by now
    asked: Wrench = (0.0, 0.0, 0.0)
    key_ns: int | None = None  # exposure of the key frame whose clone is in the state
    refused: int = 0  # fixes in a row
    restarts: int = 0
    stays: Symmetric = ZERO  # of the newest fix, (x, y, psi)
    nis: float = 0.0  # of the newest measurement
    has_target: bool = False  # its place is in the state

    @property
    def pose(self) -> Vector:
        return self.x[0], self.x[1], self.x[2]

    @property
    def covariance(self) -> Symmetric:
        """Of (x, y, psi), what fluctuates."""
        a, b, c = self.P[:3]
        return a[0], a[1], a[2], b[1], b[2], c[2]


def begin(t_ns: int, pose: Vector, covariance: Symmetric, stays: Symmetric = ZERO, gyro: bool = False) -> Belief:
    """At that pose, at rest for all that is known, nothing learnt."""
    xx, xy, xp, yy, yp, pp = covariance
    variances = *FIRST, *FIRST_LEARNT, *((FIRST_BIAS_RAD_S * FIRST_BIAS_RAD_S,) if gyro else ())
    n = 3 + len(variances)
    P = [[0.0] * n for _ in range(n)]
    P[0][:3], P[1][:3], P[2][:3] = [xx, xy, xp], [xy, yy, yp], [xp, yp, pp]
    for i, variance in enumerate(variances, start=3):
        P[i][i] = variance
    return Belief(t_ns, (*pose, *(0.0,) * (n - 3)), frozen(P), stays=stays)


def learnt(before: Belief, begun: Belief) -> Belief:
    """One that begins anew, with what has been learnt of the body."""
    x = *begun.x[:MUNK], *before.x[MUNK:BIAS], *begun.x[BIAS:]
    kept = [(*new[:MUNK], *old[MUNK:BIAS], *new[BIAS:]) for new, old in zip(begun.P, before.P, strict=False)]
    return begun._replace(x=x, P=(*begun.P[:MUNK], *kept[MUNK:BIAS], *begun.P[BIAS:]))


def predict(belief: Belief, hull: Hull, drift: Drift, t_ns: int) -> Belief:
    """The belief at a later time, in equal steps of at most STEP_NS."""
    span_ns = t_ns - belief.t_ns
    if span_ns <= 0:
        return belief
    steps = -(-span_ns // STEP_NS)
    h = span_ns * 1e-9 / steps
    x, P, force, gyro = belief.x, belief.P, belief.force, has_gyro(belief)
    for _ in range(steps):
        m = motion(hull, x, force, belief.asked, h)
        force, half = m.force, 0.5 * h * h
        moved = (
            x[0] + h * x[3] + half * m.ax,
            x[1] + h * x[4] + half * m.ay,
            wrap(x[2] + h * x[5] + half * m.turn),
            x[3] + h * m.ax,
            x[4] + h * m.ay,
            x[5] + h * m.turn,
        )
        x = (*moved, *x[6:])
        grown = (
            1.0 - h * m.damping,
            h * m.ax_by_yaw,
            h * m.ay_by_yaw,
            1.0 - h * m.turn_damping,
            [h * by for by in m.turn_by],
        )
        once = _times_F(P, h, *grown)  # F P; of its transpose P F', the same once more gives F P F'
        rows = _times_F(tuple(zip(*once, strict=True)), h, *grown)
        for i, variance in enumerate(_noise(drift, m)[: BIAS - 3 + gyro], start=3):
            rows[i][i] += h * variance
        P = frozen(rows)
    return belief._replace(t_ns=t_ns, x=x, P=P, force=force)


def _noise(drift: Drift, m: Motion) -> tuple[float, ...]:
    """Densities for v, r, d and bias: the more a robot swims, the more of it is only believed."""
    speed2 = drift.speed * drift.speed + m.doubt * m.doubt * drift.doubt_s
    rate2 = drift.rate * drift.rate + m.turn_doubt * m.turn_doubt * drift.doubt_s
    push2, twist2 = drift.push * drift.push, drift.twist * drift.twist
    return speed2, speed2, rate2, push2, push2, twist2, 0.0, 0.0, drift.bias * drift.bias


def _times_F(
    P: Rows, h: float, v_by_v: float, vx_by_yaw: float, vy_by_yaw: float, r_by_r: float, r_by: Sequence[float]
) -> list[list[float]]:
    """F P: only these six rows change."""
    x, y, psi, vx, vy, r, dx, dy, dpsi, munk, gain = P[:BIAS]
    by_psi, by_vx, by_vy, by_munk, by_gain = r_by
    return [
        [a + h * b for a, b in zip(x, vx, strict=True)],
        [a + h * b for a, b in zip(y, vy, strict=True)],
        [a + h * b for a, b in zip(psi, r, strict=True)],
        [v_by_v * a + h * b + vx_by_yaw * c for a, b, c in zip(vx, dx, psi, strict=True)],
        [v_by_v * a + h * b + vy_by_yaw * c for a, b, c in zip(vy, dy, psi, strict=True)],
        [
            r_by_r * a + h * b + by_psi * c + by_vx * d + by_vy * e + by_munk * f + by_gain * g
            for a, b, c, d, e, f, g in zip(r, dpsi, psi, vx, vy, munk, gain, strict=True)
        ],
        *(list(row) for row in P[6:]),
    ]


def ask(belief: Belief, hull: Hull, wrench: Wrench) -> Belief:
    """That wrench is asked for from now on.

    With the first one thrusters turn, and push besides as nobody knows. With the last one they stand still, and of what
    was believed to push that share goes on which is likely to be the tether's: of d = t + z, z being gone, there is
    left t = d T^2 / (T^2 + Z^2), and Z^2 of that share is not known.
    """
    turned, turn = any(belief.asked), any(wrench)
    if turned == turn:
        return belief._replace(asked=wrench)
    push, twist = (ZERO_N / hull.mass_kg, TETHER_N / ZERO_N), (ZERO_NM / hull.inertia_kgm2, TETHER_NM / ZERO_NM)
    x, rows = list(belief.x), [list(row) for row in belief.P]
    for i, (zero, ratio) in ((6, push), (7, push), (8, twist)):
        if turn:
            rows[i][i] += zero * zero
            continue
        share = ratio * ratio / (1.0 + ratio * ratio)
        x[i] *= share
        rows[i] = [share * a for a in rows[i]]
        for row in rows:
            row[i] *= share
        rows[i][i] += share * zero * zero
    return belief._replace(asked=wrench, x=tuple(x), P=frozen(rows))


def keep_key(belief: Belief) -> Belief:
    """With the pose of now as that of the key frame; the clone before it is forgotten."""
    n = own(belief)
    x, rows = belief.x[:n], [row[:n] for row in belief.P[:n]]
    wider = [(*row, *row[:3]) for row in rows]
    return belief._replace(x=(*x, *x[:3]), P=(*wider, *wider[:3]), key_ns=belief.t_ns)


def own(belief: Belief) -> int:
    """How many numbers of the state are no clone's, which follow them."""
    return len(belief.x) - (0 if belief.key_ns is None else 3)


def has_gyro(belief: Belief) -> bool:
    return own(belief) - (3 if belief.has_target else 0) > BIAS


def frozen(rows: Sequence[Sequence[float]]) -> Covariance:
    return tuple(tuple(row) for row in rows)
