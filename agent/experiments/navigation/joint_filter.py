"""The bound: one filter that has every measurement of all robots at once, and keeps every correlation.

State: of each robot (x, y, psi, v_x, v_y, r, d_x, d_y, d_psi) and what is learnt of its body (2), the pose that it had
at its key frame, and what all its samples of the target have wrong alike (3); and the target, at rest (3). The motion
and its noise are the kernel's own (pose_filter), so what separates robots from this filter is that
they do not tell each other all.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.plane_odometry import odometry
from agent.capabilities.swim.pose_filter import FIRST, FIRST_LEARNT, STEP_NS, Drift, Hull, Wrench, motion
from agent.capabilities.swim.projection import View, view
from agent.capabilities.swim.tag_fix import Map, NoFix, Priors, TagFix, first_fix, priors, tag_fix, whole
from agent.core.config import Fleet, Pose
from agent.core.linear_algebra import ZERO, wrap
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.camera_model import Calibration, camera_pose
from agent.core.ranging.fix import EXACT, Fix, Outline, locate
from agent.core.step_io import Flow, SeenTags
from agent.experiments.navigation.swimmers import Asked, Carriage, Measured, Sample

Array = NDArray[np.float64]

OWN, EACH = 11, 17  # of a robot: what moves; all of it, with its key pose at 11 and its bias at 14
ANYWHERE_M2 = 100.0  # variance of a target that no robot has seen


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


# --- the filter over the notes of a run: fixes, odometry and samples made anew, at its own estimates ---


class KeyFrame(NamedTuple):
    """Points were found that later frames follow."""


ORDER = (Asked, SeenTags, Flow, Sample, KeyFrame)  # of one moment


def joint_filter_of(measured: Sequence[Measured], fleet: Fleet, known: Sequence[Calibration]) -> JointFilter:
    """The filter after all of that; known: of each robot."""
    keys = {(one.what.since_ns, one.robot) for one in measured if isinstance(one.what, Flow)}
    frames = [Measured(t_ns, robot, KeyFrame()) for t_ns, robot in sorted(keys)]
    replayed = Replayed(fleet, known)
    for one in sorted([*measured, *frames], key=lambda one: (one.t_ns, ORDER.index(type(one.what)), one.robot)):
        replayed.take(one)
    return replayed.joint


class Replayed:
    """A run as the joint filter has it."""

    def __init__(self, fleet: Fleet, known: Sequence[Calibration]) -> None:
        assert fleet.landmarks is not None
        self.joint = JointFilter(len(known))
        self._fleet, self._known = fleet, known
        self._map = Map(fleet.landmarks, markers(fleet.landmarks))
        self._stays: list[Symmetric] = [ZERO] * len(known)

    def take(self, one: Measured) -> None:
        i, joint = one.robot, self.joint
        if not joint.knows(i):
            if isinstance(one.what, SeenTags) and one.carriage is not None:
                self._begin(i, one.what, one.carriage)
            return
        joint.predict(i, one.t_ns)
        match one.what:
            case Asked():
                joint.ask(i, one.what.wrench)
            case KeyFrame():
                joint.keep_key(i, one.t_ns)
            case SeenTags() if one.carriage is not None:
                self._fix(i, one.what, one.carriage)
            case Flow() if one.carriage is not None and one.before is not None:
                self._flow(i, one.what, one.before, one.carriage)
            case Sample() if one.carriage is not None:
                self._sample(i, one.what, one.carriage)

    def _begin(self, i: int, frame: SeenTags, carriage: Carriage) -> None:
        found = first_fix(self._view(i), _priors(carriage, 0.0), self._map, frame.tags)
        if isinstance(found, TagFix):
            self.joint.begin(i, frame.t_ns, found.theta[:3], found.fluctuates)
            self._stays[i] = found.stays

    def _fix(self, i: int, frame: SeenTags, carriage: Carriage) -> None:
        before = _priors(carriage, self.joint.speed_m_s(i))
        found = tag_fix(self._view(i), before, self._map, frame.tags, self.joint.pose(i))
        if not isinstance(found, NoFix):
            self.joint.add_fix(i, found.theta[:3], found.fluctuates)
            self._stays[i] = found.stays

    def _flow(self, i: int, flow: Flow, then: Carriage, now: Carriage) -> None:
        start = whole(self.joint.key_pose(i), _priors(then, 0.0))
        end = whole(self.joint.pose(i), _priors(now, 0.0))
        tank = self._fleet.tank
        moved = odometry(self._view(i), start, end, flow.pairs, (*tank.size_m[:2], tank.surface_m), unsettled=0.0)
        if moved is not None:
            self.joint.add_flow(i, flow.since_ns, moved.pose, moved.covariance)

    def _sample(self, i: int, sample: Sample, carriage: Carriage) -> None:
        sighting, outcome, (level, gimbal) = *sample, carriage
        x, y, psi = self.joint.pose(i)
        pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(psi))
        eye = camera_pose(pose, self._fleet.body, *level, *gimbal, self._fleet.tank.surface_m)
        assert sighting.centre_px is not None and outcome.lens_position is not None and outcome.sigma is not None
        outline = Outline(
            sighting.centre_px,
            sighting.radius_px,
            sighting.score,
            sighting.focus,
            sighting.size_px,
            sighting.radius_sigma_px,
        )
        ball = self._fleet.target[sighting.target]
        cues = self._fleet.ranging.cues
        seen = locate(
            self._known[i], eye, outline, outcome.lens_position, outcome.sigma, ball, cues, EXACT
        )  # its pose is in the state
        if isinstance(seen, Fix):
            self.joint.add_sample(i, seen, self._stays[i])

    def _view(self, i: int) -> View:
        return view(self._known[i].camera, self._fleet.body, self._fleet.tank.surface_m, None)


def _priors(carriage: Carriage, speed_m_s: float) -> Priors:
    level, gimbal_deg = carriage
    return priors(level, gimbal_deg, speed_m_s, turning=False)
