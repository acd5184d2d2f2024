"""The bound: one filter for somebody who hears every measurement at once, and keeps every correlation.

State: of each robot (x, y, psi, v_x, v_y, r, d_x, d_y, d_psi) and what is learnt of its body (2), the pose that it had
at its key frame, and what all its samples of the target have wrong alike (3); and the target, at rest (3). The motion
and its noise are the kernel's own (body_model, pose_filter.Drift), so what separates robots from this filter is that
they do not tell each other all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.swim.pose_filter import FIRST, FIRST_LEARNT, STEP_NS, Drift, Hull, Wrench, motion
from agent.core.linear_algebra import wrap
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.fix import Fix

Array = NDArray[np.float64]

OWN, EACH = 11, 17  # of a robot: what moves; all of it, with its key pose at 11 and its bias at 14
ANYWHERE_M2 = 100.0  # variance of a target that nobody has seen


class JointFilter:
    """Robots by number. Times never decrease from call to call."""

    def __init__(self, robots: int) -> None:
        self.n = robots * EACH
        self.x, self.P = np.zeros(self.n + 3), np.zeros((self.n + 3, self.n + 3))
        self.P[self.n :, self.n :] = ANYWHERE_M2 * np.eye(3)
        self._since_ns: list[int | None] = [None] * robots  # time of a robot's state; None: it was not seen yet
        self._force: list[Wrench] = [(0.0, 0.0, 0.0)] * robots
        self._asked: list[Wrench] = [(0.0, 0.0, 0.0)] * robots
        self._key_ns: list[int | None] = [None] * robots
        self._biased = [False] * robots
        self._hull = Hull()
        drift = Drift()
        q = (0.0, 0.0, 0.0, drift.speed, drift.speed, drift.rate, drift.push, drift.push, drift.twist, 0.0, 0.0)
        self._Q = np.diag(np.square(q))

    def knows(self, i: int) -> bool:
        return self._since_ns[i] is not None

    def pose(self, i: int) -> Vector:
        x, y, psi = self.x[EACH * i : EACH * i + 3].tolist()
        return x, y, psi

    def key_pose(self, i: int) -> Vector:
        x, y, psi = self.x[EACH * i + OWN : EACH * i + OWN + 3].tolist()
        return x, y, psi

    def speed_m_s(self, i: int) -> float:
        return float(np.hypot(*self.x[EACH * i + 3 : EACH * i + 5]))

    @property
    def target(self) -> tuple[Array, Array]:
        """Where it is (3,), and the covariance of that (3, 3)."""
        return self.x[self.n :].copy(), self.P[self.n :, self.n :].copy()

    def begin(self, i: int, t_ns: int, pose: Vector, fluctuates: Symmetric) -> None:
        """The first fix of robot i."""
        k = EACH * i
        self.x[k : k + 3] = pose
        self.P[k : k + 3, k : k + 3] = full(fluctuates)
        self.P[k + 3 : k + OWN, k + 3 : k + OWN] = np.diag(FIRST + FIRST_LEARNT)
        self._since_ns[i] = t_ns

    def predict(self, i: int, t_ns: int) -> None:
        """Robot i moves on to t_ns under the force that it asked for last."""
        since_ns = self._since_ns[i]
        if since_ns is None or t_ns <= since_ns:
            return
        steps = -(-(t_ns - since_ns) // STEP_NS)
        h = (t_ns - since_ns) * 1e-9 / steps
        drift = Drift()
        own = slice(EACH * i, EACH * i + OWN)
        for _ in range(steps):
            x = self.x[own]
            m = motion(self._hull, tuple(x.tolist()), self._force[i], self._asked[i], h)
            self._force[i], half = m.force, 0.5 * h * h
            x[:3] += h * x[3:6] + half * np.array([m.ax, m.ay, m.turn])
            x[3:6] += h * np.array([m.ax, m.ay, m.turn])
            F = np.eye(OWN)
            F[[0, 1, 2], [3, 4, 5]] = F[[3, 4, 5], [6, 7, 8]] = h
            F[3, 3] = F[4, 4] = 1.0 - h * m.damping
            F[5, 5] = 1.0 - h * m.turn_damping
            F[3, 2], F[4, 2] = h * m.ax_by_yaw, h * m.ay_by_yaw
            F[5, [2, 3, 4, 9, 10]] = h * np.array(m.turn_by)
            self.P[own, :] = F @ self.P[own, :]
            self.P[:, own] = self.P[:, own] @ F.T
            doubts = drift.doubt_s * np.square((m.doubt, m.doubt, m.turn_doubt))  # as pose_filter.predict
            self.P[own, own] += h * (self._Q + np.diag((0.0, 0.0, 0.0, *doubts, *(0.0,) * 5)))
        self._since_ns[i] = t_ns

    def ask(self, i: int, wrench: Wrench) -> None:
        self._asked[i] = wrench

    def add_fix(self, i: int, pose: Vector, fluctuates: Symmetric) -> None:
        """Tags put robot i there now."""
        k = EACH * i
        H = np.zeros((3, len(self.x)))
        H[:, k : k + 3] = np.eye(3)
        x, y, psi = self.pose(i)
        self._correct(H, (pose[0] - x, pose[1] - y, wrap(pose[2] - psi)), full(fluctuates))

    def keep_key(self, i: int, t_ns: int) -> None:
        """Robot i's key frame was exposed now."""
        own, key = slice(EACH * i, EACH * i + 3), slice(EACH * i + OWN, EACH * i + OWN + 3)
        self.x[key] = self.x[own]
        self.P[key, :] = self.P[own, :]
        self.P[:, key] = self.P[:, own]
        self._key_ns[i] = t_ns

    def add_flow(self, i: int, since_ns: int, moved: Vector, covariance: Symmetric) -> None:
        """Odometry of robot i from its key frame to now."""
        if self._key_ns[i] != since_ns:
            return
        k, n = EACH * i, EACH * i + OWN
        key_x, key_y, key_psi = self.x[n : n + 3].tolist()
        x, y, psi = self.pose(i)
        c, s = math.cos(key_psi), math.sin(key_psi)
        ahead, left = c * (x - key_x) + s * (y - key_y), c * (y - key_y) - s * (x - key_x)
        H = np.zeros((3, len(self.x)))
        H[:2, k : k + 2] = ((c, s), (-s, c))
        H[:2, n : n + 2] = ((-c, -s), (s, -c))
        H[:2, n + 2] = left, -ahead
        H[2, k + 2], H[2, n + 2] = 1.0, -1.0
        misses = moved[0] - ahead, moved[1] - left, wrap(moved[2] - wrap(psi - key_psi))
        self._correct(H, misses, full(covariance))

    def add_sample(self, i: int, seen: Fix, stays: Symmetric) -> None:
        """Robot i measured the target from the pose that this filter gives it now; seen: without that pose's errors.

        stays: of that pose, what is wrong in every fix alike. It and what stays of the measurement are taken for one
        error, the same in all samples of the robot, as the kernel takes them.
        """
        k, bias, end = EACH * i, EACH * i + OWN + 3, self.n
        x, y, _ = self.pose(i)
        J = np.zeros((3, 3))
        J[0, 0] = J[1, 1] = 1.0
        J[0, 2], J[1, 2] = y - seen.position_m[1], seen.position_m[0] - x
        if not self._biased[i]:
            self._biased[i] = True
            self.P[bias : bias + 3, bias : bias + 3] = full(seen.systematic_m2) + J @ full(stays) @ J.T
        H = np.zeros((3, len(self.x)))
        H[:, k : k + 3] = -J
        H[:, bias : bias + 3] = H[:, end:] = np.eye(3)
        misses = np.array(seen.position_m) - self.x[end:] - self.x[bias : bias + 3]
        self._correct(H, misses, full(seen.random_m2))

    def _correct(self, H: Array, misses: Sequence[float] | Array, R: Array) -> None:
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        self.x += K @ np.asarray(misses)
        rest = np.eye(len(self.x)) - K @ H
        self.P = rest @ self.P @ rest.T + K @ R @ K.T
        self.P = 0.5 * (self.P + self.P.T)


def full(symmetric: Symmetric) -> Array:
    """(3, 3) of xx xy xz yy yz zz."""
    xx, xy, xz, yy, yz, zz = symmetric
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
