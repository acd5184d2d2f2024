"""What is measured of a pose filter's state, one at a time: landmarks, odometry since a key frame, a gyro's rate, a
target at rest.

An observation that one honest one in a thousand would be is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from agent.capabilities.swim.pose_filter import BIAS, Belief, Covariance, begin, frozen, has_gyro, learnt, own
from agent.core.linear_algebra import cholesky, dot, lower_inverse, wrap
from agent.core.messages import Symmetric, Vector

GATE = 16.27  # NIS of three numbers: one in a thousand is larger
REFUSALS = 5  # of fixes in a row, after which it is the filter that is wrong
RATE_RAD_S = math.radians(0.3)  # noise of the gyro
YAW_KNOWN_RAD = math.radians(5.0)  # beyond, what a yaw does to a place is not linear: a sighting would lend false trust

Sparse = tuple[tuple[int, float], ...]  # a row of H: (index, weight) where it is not zero


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
    again = learnt(belief, begin(belief.t_ns, pose, fluctuates, stays, has_gyro(belief)))
    return again._replace(force=belief.force, asked=belief.asked, restarts=belief.restarts + 1, nis=corrected.nis)


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
    n = own(belief)
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
