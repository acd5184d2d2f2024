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

from agent.kernel.estimation.matrix import ZERO
from agent.kernel.messages import Symmetric, Vector
from agent.kernel.navigation.angle import wrap
from agent.kernel.navigation.body_model import STEP_NS, ZERO_N, ZERO_NM, Hull, Motion, Wrench, motion
from agent.kernel.navigation.dense import Rows, cholesky, dot, inverse

GATE = 16.27  # NIS of three numbers: one in a thousand is larger
REFUSALS = 5  # of fixes in a row, after which it is the filter that is wrong
RATE_RAD_S = math.radians(0.3)  # noise of the gyro
YAW_KNOWN_RAD = math.radians(5.0)  # beyond, what a yaw does to a place is not linear: a sighting would lend false trust
FIRST_BIAS_RAD_S = math.radians(0.6)
# Variances of v, r and d before anything was learnt: who was lost swims on for a while, and spins.
FIRST = (2e-2, 2e-2, 2.5e-1, 4e-3, 4e-3, 1e-1)
# Of what stays: Munk's difference of added masses, kg^2, and by how much a yaw moment is larger than what was asked.
FIRST_LEARNT = (0.8 * 0.8, 0.2 * 0.2)
MUNK, GAIN, BIAS = 9, 10, 11  # where they are in the state

State = tuple[float, ...]
Covariance = tuple[tuple[float, ...], ...]
Sparse = tuple[tuple[int, float], ...]  # a row of H: (index, weight) where it is not zero


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
    return Belief(t_ns, (*pose, *(0.0,) * (n - 3)), _frozen(P), stays=stays)


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
    x, P, force, gyro = belief.x, belief.P, belief.force, _has_gyro(belief)
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
        P = _frozen(rows)
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
    """That wrench is asked for from now on. With the first one thrusters turn, and push besides as nobody knows."""
    turned, turn = any(belief.asked), any(wrench)
    if turned == turn:
        return belief._replace(asked=wrench)
    push, twist = ZERO_N / hull.mass_kg, ZERO_NM / hull.inertia_kgm2
    rows = [list(row) for row in belief.P]
    for i, sigma in ((6, push), (7, push), (8, twist)):
        rows[i][i] += sigma * sigma
    return belief._replace(asked=wrench, P=_frozen(rows))


def add_fix(belief: Belief, pose: Vector, fluctuates: Symmetric, stays: Symmetric) -> Belief:
    """Corrected by a fix of now; one that cannot be is refused, and after five in a row it all starts again from it."""
    xx, xy, xp, yy, yp, pp = fluctuates
    H = ((0, 1.0),), ((1, 1.0),), ((2, 1.0),)
    misses = pose[0] - belief.x[0], pose[1] - belief.x[1], wrap(pose[2] - belief.x[2])
    corrected = _correct(belief, H, misses, ((xx, xy, xp), (xy, yy, yp), (xp, yp, pp)))
    if corrected.nis <= GATE:
        return corrected._replace(refused=0, stays=stays)
    if belief.refused + 1 < REFUSALS:
        return belief._replace(refused=belief.refused + 1, nis=corrected.nis)
    again = learnt(belief, begin(belief.t_ns, pose, fluctuates, stays, _has_gyro(belief)))
    return again._replace(force=belief.force, asked=belief.asked, restarts=belief.restarts + 1, nis=corrected.nis)


def keep_key(belief: Belief) -> Belief:
    """With the pose of now as that of the key frame; the clone before it is forgotten."""
    n = _own(belief)
    x, rows = belief.x[:n], [row[:n] for row in belief.P[:n]]
    wider = [(*row, *row[:3]) for row in rows]
    return belief._replace(x=(*x, *x[:3]), P=(*wider, *wider[:3]), key_ns=belief.t_ns)


def add_flow(belief: Belief, since_ns: int, moved: Vector, covariance: Symmetric) -> Belief:
    """Corrected by odometry: (x, y, yaw) of now, in the frame that the body had at the key frame exposed at since_ns.

    Of a key frame that was let go it says nothing any more.
    """
    if belief.key_ns != since_ns:
        return belief
    n = _own(belief)
    key_x, key_y, key_psi = belief.x[n:]
    c, s = math.cos(key_psi), math.sin(key_psi)
    east, north = belief.x[0] - key_x, belief.x[1] - key_y
    ahead, left = c * east + s * north, c * north - s * east
    H = (
        ((0, c), (1, s), (n, -c), (n + 1, -s), (n + 2, left)),
        ((0, -s), (1, c), (n, s), (n + 1, -c), (n + 2, -ahead)),
        ((2, 1.0), (n + 2, -1.0)),
    )
    turned = wrap(belief.x[2] - key_psi)
    misses = moved[0] - ahead, moved[1] - left, wrap(moved[2] - turned)
    xx, xy, xp, yy, yp, pp = covariance
    corrected = _correct(belief, H, misses, ((xx, xy, xp), (xy, yy, yp), (xp, yp, pp)))
    return corrected if corrected.nis <= GATE else belief._replace(nis=corrected.nis)


def add_rate(belief: Belief, rate_rad_s: float) -> Belief:
    """Corrected by a gyro's yaw rate of now."""
    H = (((5, 1.0), (BIAS, 1.0)),)
    return _correct(belief, H, (rate_rad_s - belief.x[5] - belief.x[BIAS],), ((RATE_RAD_S * RATE_RAD_S,),))


def add_sighting(belief: Belief, offset_m: Vector, noise_m2: Symmetric) -> Belief:
    """With a target at rest seen now: the first sighting puts its place into the state, later ones correct both.

    offset_m: ahead and to the left of the robot as its yaw has it, and the height in the world; noise_m2: of that, in
    the world. One while the yaw is poorly known says nothing.
    """
    if belief.P[2][2] > YAW_KNOWN_RAD * YAW_KNOWN_RAD:
        return belief
    c, s = math.cos(belief.x[2]), math.sin(belief.x[2])
    east, north = c * offset_m[0] - s * offset_m[1], s * offset_m[0] + c * offset_m[1]
    seen_m = belief.x[0] + east, belief.x[1] + north, offset_m[2]
    xx, xy, xz, yy, yz, zz = noise_m2
    R = (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)
    n = _own(belief)
    if belief.has_target:
        H = ((n - 3, 1.0), (0, -1.0), (2, north)), ((n - 2, 1.0), (1, -1.0), (2, -east)), ((n - 1, 1.0),)
        misses = [place - belief.x[n - 3 + k] for k, place in enumerate(seen_m)]
        corrected = _correct(belief, H, misses, R)
        return corrected if corrected.nis <= GATE else belief._replace(nis=corrected.nis)
    G: tuple[Sparse, ...] = ((0, 1.0), (2, -north)), ((1, 1.0), (2, east)), ()
    cross = [[_along(g, row) for row in belief.P] for g in G]  # 3 x n
    middle = [[_along(g, row) + r for g, r in zip(G, noise, strict=True)] for row, noise in zip(cross, R, strict=True)]
    rows = [(*row[:n], *column, *row[n:]) for row, column in zip(belief.P, zip(*cross, strict=True), strict=True)]
    new = [(*row[:n], *block, *row[n:]) for row, block in zip(cross, middle, strict=True)]
    P = _frozen([*rows[:n], *new, *rows[n:]])
    return belief._replace(x=(*belief.x[:n], *seen_m, *belief.x[n:]), P=P, has_target=True)


def _correct(belief: Belief, H: Sequence[Sparse], misses: Sequence[float], R: Covariance) -> Belief:
    """Joseph's form: P stays positive whatever is rounded off."""
    P = belief.P
    HP = [[_along(h, row) for row in P] for h in H]
    S = [[_along(h, hp) + r for h, r in zip(H, noise, strict=True)] for hp, noise in zip(HP, R, strict=True)]
    L = cholesky(S)
    if L is None:
        raise ValueError("the covariance of the pose is not positive")
    W = inverse(L)
    nis = dot(misses, [dot(row, misses) for row in W])
    K = [[dot(row, column) for row in W] for column in zip(*HP, strict=True)]  # n x m
    x = [a + dot(gain, misses) for a, gain in zip(belief.x, K, strict=True)]
    x[2] = wrap(x[2])
    columns = tuple(zip(*K, strict=True))
    rows: list[tuple[float, ...]] = []
    for i, (before, gain) in enumerate(zip(P, K, strict=True)):
        kept = _less(before, gain, HP)  # row i of (I - K H) P
        # ... (I - K H)' + K R K': what H sees of it, less the noise that K lets in, goes by the gains.
        pulls = [_along(h, kept) - dot(gain, noise) for h, noise in zip(H, R, strict=True)]
        kept = _less(kept, pulls, columns)
        rows.append((*[row[i] for row in rows], *kept[i:]))  # symmetric to the bit
    return belief._replace(x=tuple(x), P=tuple(rows), nis=nis)


def _own(belief: Belief) -> int:
    """How many numbers of the state are no clone's, which follow them."""
    return len(belief.x) - (0 if belief.key_ns is None else 3)


def _has_gyro(belief: Belief) -> bool:
    return _own(belief) - (3 if belief.has_target else 0) > BIAS


def _along(h: Sparse, row: Sequence[float]) -> float:
    """h row"""
    total = 0.0
    for i, weight in h:
        total += weight * row[i]
    return total


def _less(row: Sequence[float], weights: Sequence[float], rows: Sequence[Sequence[float]]) -> list[float]:
    """row - sum of weights times rows; there are three of these, or one."""
    if len(rows) == 1:
        return [a - weights[0] * b for a, b in zip(row, rows[0], strict=True)]
    (p, q, r), (b, c, d) = weights, rows
    return [a - p * i - q * j - r * k for a, i, j, k in zip(row, b, c, d, strict=True)]


def _frozen(rows: Sequence[Sequence[float]]) -> Covariance:
    return tuple(tuple(row) for row in rows)
