"""Where a robot is and how it moves: an extended Kalman filter, driven by the forces that were asked for.

State (x, y, psi, v_x, v_y, r, d_x, d_y, d_psi), what is learnt of the body and stays (by how many kg its added mass is
larger aside than ahead, by what share its yaw moment is larger than was asked), the bias of the yaw rate where there is
a gyro, and, once there is a key frame, the (x, y, psi) that the robot had when it was exposed: its clone, which what is
seen since is measured from (Mourikis et al. 2007, stochastic cloning). A filter that smooths a sighting (event_ring.py)
has the place (x, y, z) of a target at rest before the clone. Lengths m, angles rad. Covariances of what fluctuates:
what survey and zeros have wrong in every fix alike, `stays`, is added once where the pose is used.

The body model comes first, then prediction, corrections by measurements, and the walls that no pose is beyond.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from agent.core.linear_algebra import ZERO, Rows, cholesky, dot, lower_inverse, wrap
from agent.core.messages import Symmetric, Vector

# --- body model ---
# How a robot moves in the plane under the forces that it was asked for: constants, and one small step.
#
# x, y and velocity in the world frame; force and moment in the body frame (forward, left, anticlockwise). Thrusters
# follow with a lag of first order, drag is linear and quadratic; what pushes besides (tether, current) is an
# acceleration d.

OF_THRUST, OF_DRAG = 0.15, 0.4  # share, one sigma: thrusters' gains and the mass; drag may be half or twice as large
OF_TURN = 0.05  # of the moment, what its own gain, which is learnt, leaves: no two thrusters have the same lag
ARM_M = 0.003  # of every push, which makes some moment: no two thrusters are alike
# What a moment is off by while thrusters turn: near zero each gives what its own dead band leaves of a small thrust,
# and T5-T8 do not quite undo what nudges of T1-T4 turn (hw/firmware/motor_control.py). Robots of the twin that hover
# are off by as much as they say with this.
DEAD_NM = 0.0008
# What thrust has wrong while it stays the same is a push, which is learnt: in doubt is only what differs from the mean
# of so long. Else a robot that holds against a steady pull of 1.5 N would never know how it moves.
STEADY_S = 8.0

# An ESC's zero is off by some 5 us; where thrusters are kept turning (hw/firmware/thrust.py) that is 0.09 N of each of
# four, at 0.17 m: what pushes and turns a robot from when they turn on, and no longer.
ZERO_N, ZERO_NM = 0.12, 0.03
TETHER_N, TETHER_NM = 0.15, 0.004  # what is left of one whose thrusters stand still: its tether pulls

Wrench = tuple[float, float, float]  # N forward, N left, N m

STEP_NS = 20_000_000  # no longer: what drag and turn change over it is neglected to first order


class Hull(NamedTuple):
    """Constants of a robot of 30 cm with its added mass; each may be half or twice as large."""

    mass_kg: float = 6.0
    drag: float = 2.0  # N s/m
    drag2: float = 20.0  # N s^2/m^2
    inertia_kgm2: float = 0.09
    turn_drag: float = 0.03  # N m s
    turn_drag2: float = 0.10  # N m s^2
    lag_s: float = 0.115  # of the thrusters


class Motion(NamedTuple):
    """Accelerations over one step, and how they change with what they depend on."""

    force: Wrench  # that acts at the end of the step
    steady: Wrench  # its mean of late
    ax: float
    ay: float
    turn: float  # rad/s^2
    damping: float  # -da/dv, 1/s
    turn_damping: float
    ax_by_yaw: float
    ay_by_yaw: float
    turn_by: tuple[float, float, float, float, float]  # yaw, v_x, v_y, Munk's difference, gain of the yaw moment
    doubt: float  # sigma of the acceleration, m/s^2, for what thrust and drag are not known to
    turn_doubt: float  # rad/s^2


def motion(
    hull: Hull, state: tuple[float, ...], force: Wrench, asked: Wrench, h: float, steady: Wrench = (0.0, 0.0, 0.0)
) -> Motion:
    """What a step of h seconds does from state = (x, y, psi, v_x, v_y, r, d_x, d_y, d_psi, munk, gain, ...).

    Of a body that swims aslant, added mass that differs aside and ahead makes a moment: Munk's, that difference times
    both speeds.
    """
    _, _, psi, vx, vy, r, dx, dy, dpsi, munk_kg, gain = state[:11]
    reached = 1.0 - math.exp(-h / hull.lag_s)
    share = 1.0 - hull.lag_s * reached / h  # of the way to what is asked, on average over the step
    ahead, left, moment = (f + (u - f) * share for f, u in zip(force, asked, strict=True))
    c, s = math.cos(psi), math.sin(psi)
    px, py = (c * ahead - s * left) / hull.mass_kg, (s * ahead + c * left) / hull.mass_kg
    k, k_r = damping(hull, math.sqrt(vx * vx + vy * vy)), turn_damping(hull, r)
    f, g, n = (f + (u - f) * reached for f, u in zip(force, asked, strict=True))
    spin = moment / hull.inertia_kgm2
    fresh_n, fresh_nm = math.hypot(ahead - steady[0], left - steady[1]), moment - steady[2]
    doubt = math.hypot(OF_THRUST * fresh_n / hull.mass_kg, OF_DRAG * k * math.hypot(vx, vy))
    of_nm = OF_TURN * fresh_nm, ARM_M * fresh_n, DEAD_NM if any(asked) else 0.0
    turn_doubt = math.hypot(math.hypot(*of_nm) / hull.inertia_kgm2, OF_DRAG * k_r * r)
    u, v, bent = c * vx + s * vy, c * vy - s * vx, munk_kg / hull.inertia_kgm2
    ax, ay, turn = px - k * vx + dx, py - k * vy + dy, (1.0 + gain) * spin - bent * u * v - k_r * r + dpsi
    by_speed = -bent * (c * v - s * u), -bent * (s * v + c * u)
    turn_by = (bent * (u * u - v * v), *by_speed, -u * v / hull.inertia_kgm2, spin)
    forget = h / STEADY_S
    mean = tuple(was + forget * (now - was) for was, now in zip(steady, (f, g, n), strict=True))
    return Motion((f, g, n), (mean[0], mean[1], mean[2]), ax, ay, turn, k, k_r, -py, px, turn_by, doubt, turn_doubt)


def damping(hull: Hull, speed_m_s: float) -> float:
    """Deceleration by drag, for each m/s, 1/s."""
    return (hull.drag + hull.drag2 * speed_m_s) / hull.mass_kg


def turn_damping(hull: Hull, rate_rad_s: float) -> float:
    return (hull.turn_drag + hull.turn_drag2 * abs(rate_rad_s)) / hull.inertia_kgm2


# --- prediction ---

FIRST_BIAS_RAD_S = math.radians(0.6)
# Variances of v, r and d before anything was learnt: a robot that was lost swims on for a while, and spins.
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
    steady: Wrench = (0.0, 0.0, 0.0)  # mean of late
    asked: Wrench = (0.0, 0.0, 0.0)
    key_ns: int | None = None  # exposure of the key frame whose clone is in the state
    refused: int = 0  # fixes in a row
    agreed_ns: int = 0  # exposure of the newest frame whose tags, or points, agreed with it
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
    return Belief(t_ns, (*pose, *(0.0,) * (n - 3)), frozen(P), agreed_ns=t_ns, stays=stays)


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
    x, P, force, steady, gyro = belief.x, belief.P, belief.force, belief.steady, has_gyro(belief)
    for _ in range(steps):
        m = motion(hull, x, force, belief.asked, h, steady)
        force, steady, half = m.force, m.steady, 0.5 * h * h
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
    return belief._replace(t_ns=t_ns, x=x, P=P, force=force, steady=steady)


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

    With the first one thrusters turn, and push besides by what is not known. With the last one they stand still, and of
    what was believed to push that share goes on which is likely to be the tether's: of d = t + z, z being gone, there
    is left t = d T^2 / (T^2 + Z^2), and Z^2 of that share is not known.
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


def target_of(belief: Belief) -> tuple[Vector, Symmetric]:
    """The place of the target that is in the state, and the covariance of that, m and m^2."""
    n, x, P = own(belief) - 3, belief.x, belief.P
    spread = P[n][n], P[n][n + 1], P[n][n + 2], P[n + 1][n + 1], P[n + 1][n + 2], P[n + 2][n + 2]
    return (x[n], x[n + 1], x[n + 2]), spread


def frozen(rows: Sequence[Sequence[float]]) -> Covariance:
    return tuple(tuple(row) for row in rows)


# --- corrections ---
# Measurements of the filter's state, one at a time: landmarks, odometry since a key frame, a gyro's rate. One whose NIS
# only one honest measurement in a thousand exceeds is refused. And the sighting of a target at rest.

GATE = 16.27  # NIS of three numbers: one in a thousand is larger
REFUSALS = 5  # of fixes in a row, after which it is the filter that is wrong
OF_AGREEING = 2  # the same where the newest is by three tags that agree, and more: they are not wrong alike
AGREEING = 3
RATE_RAD_S = math.radians(0.3)  # noise of the gyro
YAW_KNOWN_RAD = math.radians(5.0)  # beyond, what a yaw does to a place is not linear: a sighting would lend false trust

Sparse = tuple[tuple[int, float], ...]  # a row of H: (index, weight) where it is not zero


def add_fix(belief: Belief, pose: Vector, fluctuates: Symmetric, stays: Symmetric, agreeing: int = 1) -> Belief:
    """Corrected by a fix of now; one that cannot be is refused, and after five in a row it all starts again from it.

    agreeing: tags of which each says the same; of three, the second in a row is believed.
    """
    xx, xy, xp, yy, yp, pp = fluctuates
    H = ((0, 1.0),), ((1, 1.0),), ((2, 1.0),)
    misses = pose[0] - belief.x[0], pose[1] - belief.x[1], wrap(pose[2] - belief.x[2])
    corrected = _correct(belief, H, misses, ((xx, xy, xp), (xy, yy, yp), (xp, yp, pp)))
    if corrected.nis <= GATE:
        return corrected._replace(refused=0, agreed_ns=belief.t_ns, stays=stays)
    if belief.refused + 1 < (OF_AGREEING if agreeing >= AGREEING else REFUSALS):
        return belief._replace(refused=belief.refused + 1, nis=corrected.nis)
    again = learnt(belief, begin(belief.t_ns, pose, fluctuates, stays, has_gyro(belief)))
    again = again._replace(force=belief.force, steady=belief.steady, asked=belief.asked)
    return again._replace(restarts=belief.restarts + 1, nis=corrected.nis)


def add_flow(belief: Belief, since_ns: int, moved: Vector, covariance: Symmetric) -> Belief:
    """Corrected by odometry: (x, y, yaw) of now, in the frame that the body had at the key frame exposed at since_ns.

    Of a key frame that was let go it says nothing any more.
    """
    if belief.key_ns != since_ns:
        return belief
    n = own(belief)
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
    agrees = corrected.nis <= GATE
    return corrected._replace(agreed_ns=belief.t_ns) if agrees else belief._replace(nis=corrected.nis)


def add_rate(belief: Belief, rate_rad_s: float) -> Belief:
    """Corrected by a gyro's yaw rate of now."""
    H = (((5, 1.0), (BIAS, 1.0)),)
    return _correct(belief, H, (rate_rad_s - belief.x[5] - belief.x[BIAS],), ((RATE_RAD_S * RATE_RAD_S,),))


def add_sighting(belief: Belief, offset_m: Vector, noise_m2: Symmetric) -> Belief:
    """With the place of a target at rest, seen now, in the state.

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
    n = own(belief)
    G: tuple[Sparse, ...] = ((0, 1.0), (2, -north)), ((1, 1.0), (2, east)), ()
    cross = [[_along(g, row) for row in belief.P] for g in G]  # 3 x n
    middle = [[_along(g, row) + r for g, r in zip(G, noise, strict=True)] for row, noise in zip(cross, R, strict=True)]
    rows = [(*row[:n], *column, *row[n:]) for row, column in zip(belief.P, zip(*cross, strict=True), strict=True)]
    new = [(*row[:n], *block, *row[n:]) for row, block in zip(cross, middle, strict=True)]
    P = frozen([*rows[:n], *new, *rows[n:]])
    return belief._replace(x=(*belief.x[:n], *seen_m, *belief.x[n:]), P=P, has_target=True)


def _correct(belief: Belief, H: Sequence[Sparse], misses: Sequence[float], R: Covariance) -> Belief:
    """Joseph's form: P stays positive whatever is rounded off."""
    P = belief.P
    HP = [[_along(h, row) for row in P] for h in H]
    S = [[_along(h, hp) + r for h, r in zip(H, noise, strict=True)] for hp, noise in zip(HP, R, strict=True)]
    L = cholesky(S)
    if L is None:
        raise ValueError("the covariance of the pose is not positive")
    W = lower_inverse(L)
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


# --- walls ---
# A robot's centre can be inside the tank, and no nearer to a wall than its hull lets it.
#
# The filter knows forces, not walls: a robot that is pulled against one while no landmark is in sight believes that it
# swims on into it, ever faster. So a belief whose mean has come beyond a wall is cut off there: of the Gaussian only
# the part within counts, and mean and covariance of that part are the belief from then on (Simon and Simon 2010,
# truncation of the density). That is done where the mean is beyond and not at every moment: the wall says the same
# thing each time, and the same thing counted again and again would make a robot sure that it is nowhere near.

HULL_M = 0.14  # from its centre to a wall that it leans against
FARTHEST = 3.0  # sigmas beyond: what is farther out was believed wrong, and tells nothing of how wrong

Side = tuple[float, float]  # from, to, m


class Basin(NamedTuple):
    """Where the centre may be."""

    x_m: Side
    y_m: Side


def basin(tank_m: Sequence[float]) -> Basin:
    """Of a tank of that length and breadth."""
    length_m, breadth_m = tank_m[:2]
    return Basin((HULL_M, length_m - HULL_M), (HULL_M, breadth_m - HULL_M))


def kept_in(belief: Belief, within: Basin) -> Belief:
    """The belief, cut off at the walls that its mean is beyond."""
    for k, (least_m, most_m) in enumerate(within):
        if belief.x[k] < least_m:
            belief = _cut_off(belief, k, least_m, 1.0)
        elif belief.x[k] > most_m:
            belief = _cut_off(belief, k, most_m, -1.0)
    return belief


def _cut_off(belief: Belief, k: int, wall_m: float, inwards: float) -> Belief:
    """Given that coordinate k is at the wall or on its inner side; inwards: 1 where that is greater, else -1.

    Of a unit Gaussian that part which is more than z has the mean h(z), its hazard, and the variance
    1 + z h - h h. All else of the state follows by how it goes along with that coordinate.
    """
    variance = belief.P[k][k]
    sigma = math.sqrt(variance)
    z = min(inwards * (wall_m - belief.x[k]) / sigma, FARTHEST)
    hazard = math.sqrt(2.0 / math.pi) * math.exp(-0.5 * z * z) / math.erfc(z / math.sqrt(2.0))
    moved_m = wall_m + inwards * sigma * (hazard - z) - belief.x[k]
    lost = hazard * (hazard - z)  # share of the variance
    gain = [row[k] / variance for row in belief.P]
    x = tuple(a + g * moved_m for a, g in zip(belief.x, gain, strict=True))
    P = tuple(
        tuple(p - (g * h) * (lost * variance) for p, h in zip(row, gain, strict=True))
        for row, g in zip(belief.P, gain, strict=True)
    )
    return belief._replace(x=(*x[:2], wrap(x[2]), *x[3:]), P=P)
