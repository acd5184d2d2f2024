"""The bound: one filter that has every measurement of all robots at once, and keeps every correlation.

State: of each robot (x, y, psi, v_x, v_y, r, d_x, d_y, d_psi) and what is learnt of its body (2), the pose that it had
at its key frame, and what all its samples of the target have wrong alike (3); and the target, at rest (3). The motion
and its noise are the kernel's own (pose_filter), so what separates robots from this filter is that
they do not tell each other all.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from agent.capabilities.swim.event_ring import offset_m
from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.localizer import Carriage
from agent.capabilities.swim.plane_odometry import Moved, odometry
from agent.capabilities.swim.pose_filter import FIRST, FIRST_LEARNT, STEP_NS, Drift, Hull, Wrench, motion
from agent.capabilities.swim.projection import View, view
from agent.capabilities.swim.tag_fix import Map, Priors, TagFix, first_fix, priors, tag_fix, whole
from agent.core.linear_algebra import ZERO, Rows, full, wrap
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.fix import Fix
from agent.core.step_io import Flow, SeenTags
from agent.experiments.navigation.swimmers import Swimmers

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
        self._steady: list[Wrench] = [(0.0, 0.0, 0.0)] * robots
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
            m = motion(self._hull, tuple(x.tolist()), self._force[i], self._asked[i], h, self._steady[i])
            self._force[i], self._steady[i], half = m.force, m.steady, 0.5 * h * h
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
            self.P[bias : bias + 3, bias : bias + 3] = J @ full(stays) @ J.T + full(seen.systematic_m2)
        H = np.zeros((3, len(self.x)))
        H[:, k : k + 3] = -J
        H[:, bias : bias + 3] = H[:, end:] = np.eye(3)
        misses = np.array(seen.position_m) - self.x[end:] - self.x[bias : bias + 3]
        self._correct(H, misses, full(seen.random_m2))

    def _correct(self, H: Array, misses: Sequence[float] | Array, R: Rows) -> None:
        S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        self.x += K @ np.asarray(misses)
        rest = np.eye(len(self.x)) - K @ H
        self.P = rest @ self.P @ rest.T + K @ R @ K.T
        self.P = 0.5 * (self.P + self.P.T)


# --- the filter over all that the robots of a run measured: fixes and odometry made anew, at its own estimates ---

ORDER = ("sent", "see", "follow", "sight", "key")  # of one moment; all but the last are methods of a Localizer


class Told(NamedTuple):
    """What a robot's own filter was told once; "key": from that frame on it followed points."""

    t_ns: int
    order: int
    robot: int
    about: tuple[Any, ...]  # arguments


class Replayed:
    """A run as the joint filter has it: for the bound, never for an agent. Make it before the first step."""

    def __init__(self, swimmers: Swimmers) -> None:
        self._told: list[Told] = []
        self.fleet, self._views = swimmers.fleet, list[View]()
        self._stays: list[Symmetric] = [ZERO] * len(swimmers.agents)
        assert self.fleet.landmarks is not None
        self._map = Map(self.fleet.landmarks, markers(self.fleet.landmarks))
        for i, name in enumerate(swimmers.agents):
            camera = swimmers.calibrations[name].camera
            self._views.append(view(camera, self.fleet.body, self.fleet.tank.surface_m, None))
            localizer = swimmers.swimmer(name).localizer
            for order, what in enumerate(ORDER[:-1]):
                setattr(localizer, what, partial(self._note, order, i, getattr(localizer, what)))

    @property
    def samples(self) -> int:
        """How often the target was measured."""
        return sum(one.order == ORDER.index("sight") for one in self._told)

    def _note(self, order: int, robot: int, told: Callable[..., None], *about: Any) -> None:
        match about:
            case (SeenTags() | Flow() as frame, *_):
                t_ns = frame.t_ns
            case (str(), Fix(), _, sample, _):
                t_ns = sample.t_ns
            case (_, now_ns):
                t_ns = now_ns
        self._told.append(Told(t_ns, order, robot, about))
        told(*about)

    def joint(self) -> JointFilter:
        """The filter after all of that."""
        joint = JointFilter(len(self._views))
        keys = {(one.about[0].since_ns, one.robot) for one in self._told if ORDER[one.order] == "follow"}
        frames = [Told(t_ns, ORDER.index("key"), robot, ()) for t_ns, robot in keys]
        for t_ns, order, i, about in sorted([*self._told, *frames], key=lambda one: one[:3]):
            joint.predict(i, t_ns)
            match ORDER[order]:
                case "see":
                    self._fix(joint, i, *about)
                case "sent":
                    joint.ask(i, about[0])
                case _ if not joint.knows(i):
                    pass
                case "key":
                    joint.keep_key(i, t_ns)
                case "follow":
                    self._flow(joint, i, *about)
                case "sight":
                    self._sample(joint, i, *about)
        return joint

    def _fix(self, joint: JointFilter, i: int, frame: SeenTags, carriage: Carriage) -> None:
        if joint.knows(i):
            before = _priors(carriage, joint.speed_m_s(i))
            found = tag_fix(self._views[i], before, self._map, frame.tags, joint.pose(i))
        else:
            found = first_fix(self._views[i], _priors(carriage), self._map, frame.tags)
        if isinstance(found, TagFix):
            add = partial(joint.add_fix, i) if joint.knows(i) else partial(joint.begin, i, frame.t_ns)
            add(found.theta[:3], found.fluctuates)
            self._stays[i] = found.stays

    def _flow(self, joint: JointFilter, i: int, flow: Flow, then: Carriage, now: Carriage, *_: Any) -> None:
        if not (then.gimbal.rests and now.gimbal.rests):
            return
        start, end = whole(joint.key_pose(i), _priors(then)), whole(joint.pose(i), _priors(now))
        tank = self.fleet.tank
        moved = odometry(self._views[i], start, end, flow.pairs, (*tank.size_m[:2], tank.surface_m), unsettled=0.0)
        if isinstance(moved, Moved):
            joint.add_flow(i, flow.since_ns, moved.pose, moved.covariance)

    def _sample(self, joint: JointFilter, i: int, target: str, seen: Fix, known: tuple[Any, ...], *_: Any) -> None:
        """The same way from the robot, from where this filter has it."""
        ahead, left, up = offset_m(known[0].pose, seen.position_m)
        x, y, psi = joint.pose(i)
        c, s = math.cos(psi), math.sin(psi)
        joint.add_sample(
            i, seen._replace(position_m=(x + c * ahead - s * left, y + s * ahead + c * left, up)), self._stays[i]
        )


def _priors(carriage: Carriage, speed_m_s: float = 0.0) -> Priors:
    turning = not carriage.gimbal.rests
    return priors(carriage.level, carriage.gimbal.deg, speed_m_s, turning, zeros=carriage.zeros)
