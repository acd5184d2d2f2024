"""Robots that rarely see tags, around a ball that others have located: how much that tells them of where they are.

In the plane, with the kernel's filters, pilot and evidence; bodies, fixes and sightings are drawn, and everything said
is heard at once. Nothing else tells a robot how it moves: no points to follow. The joint filter, which knows all that
all measured, is what can be had; it has no gyro.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agent.capabilities.swim.aided_pose import Aid, Seen, offset_m
from agent.capabilities.swim.event_ring import Event, EventRing, asked, fix, rate
from agent.capabilities.swim.localizer import LOST_DEG, LOST_M, within
from agent.capabilities.swim.pilot import Reference, wanted_velocity, wrench
from agent.capabilities.swim.pose_filter import RATE_RAD_S, Belief, Drift, Hull, begin
from agent.core.estimation.evidence_table import Table
from agent.core.estimation.fuse import fuse
from agent.core.estimation.interface import Posterior, Prior
from agent.core.linear_algebra import plus, times, upper, wrap
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.fix import Fix, carried, kappa, longest_gap_s
from agent.experiments.navigation.basin import TANK
from agent.experiments.navigation.bodies import PULL
from agent.experiments.navigation.joint_filter import Array, JointFilter, full
from agent.experiments.navigation.planar_body import PlanarBody, drawn_hull
from agent.experiments.result import Row
from hw.twin.scene import generator

S = 1_000_000_000
STEP_NS, LATE_NS, SWEPT_NS, SAMPLE_NS = S // 20, S // 10, S // 2, S  # a fix is known 0.1 s late, a sample 0.5 s
AID_AROUND_M, AID_S = 0.75, 40.0
AID_BALL_M = np.array((0.5 * TANK.size_m[0], 0.5 * TANK.size_m[1], 0.07))
TAGS: dict[str, Callable[[int], bool]] = {  # whether a robot's frames show tags, by time
    "r1": lambda t_ns: t_ns % (S // 5) == 0,
    "r2": lambda t_ns: t_ns % (S // 5) == 0 and t_ns % (4 * S) < 2 * S,
    "r3": lambda t_ns: t_ns % (4 * S) == 0,
    "r4": lambda t_ns: t_ns % (6 * S) == 0,
}
FIX = np.array((0.003, 0.003, math.radians(0.2)))  # of a fix: what fluctuates, and what stays; m, m, rad
STAYS = np.array((0.002, 0.002, math.radians(0.1)))
# Of a sighting, along the ray, across it and up: what averages out, and what does not; as the kernel has it at 0.75 m.
RANDOM_M, ALIKE_M = np.array((0.002, 0.0007, 0.001)), np.array((0.0031, 0.0008, 0.0015))
BIAS_RAD_S = math.radians(0.3)  # of a gyro


class AidSample(NamedTuple):
    """A sighting of the ball: from where it was taken, and as measured from there."""

    t_ns: int
    offset_m: Vector
    random_m2: Symmetric
    alike_m2: Symmetric


class Diver:
    """One robot: its true body, what it is told, and both of its filters."""

    def __init__(self, seed: int, name: str, way: float, gyro: bool) -> None:
        self.rng, self.name, self.tags, self.gyro = generator(seed, name, "aid"), name, TAGS[name], gyro
        place = AID_BALL_M[:2] - AID_AROUND_M * np.array((math.cos(way), math.sin(way)))
        self.goal = Reference((float(place[0]), float(place[1])), way)
        self.body = PlanarBody.resting((*place, way), drawn_hull(self.rng))
        self.stays, self.covariance = _squares(STAYS), _squares(FIX)
        self._wrong, self._alike = self.rng.normal(0.0, STAYS), self.rng.normal(0.0, ALIKE_M)
        self._bias = float(self.rng.normal(0.0, BIAS_RAD_S))
        self._pull = self.rng.normal(0.0, PULL.force_n / math.sqrt(2.0), 2)
        self.ring = EventRing(begin(0, self.fixed(), self.covariance, self.stays, gyro), Hull(), Drift())
        self.aid, self._sampled_ns = Aid(Hull()), 0
        self._fixes_ns: deque[int] = deque((0,), maxlen=64)
        self._late: deque[tuple[int, Event]] = deque()

    def fixed(self) -> Vector:
        x, y, psi = (self.body.at + self._wrong + self.rng.normal(0.0, FIX)).tolist()
        return x, y, wrap(psi)

    def swim(self, now_ns: int, by: Belief) -> Event | None:
        """One step to now_ns under what it asks for, `by` that pose; returns what its tags said there."""
        keeps = math.exp(-STEP_NS * 1e-9 / PULL.correlation_s)
        fresh = self.rng.normal(0.0, PULL.force_n / math.sqrt(2.0), 2)
        self._pull = keeps * self._pull + math.sqrt(1.0 - keeps * keeps) * fresh
        knows = within(self.at(by.t_ns), LOST_M, LOST_DEG)
        self.asked = wrench(by, Hull(), self.goal, wanted_velocity(by, self.goal)) if knows else (0.0, 0.0, 0.0)
        self._tell(asked(by.t_ns, self.asked))
        self.body.swim(self.asked, STEP_NS * 1e-9, (*self._pull, 0.0))
        if self.gyro:
            self._tell(rate(now_ns, float(self.body.speed[2] + self._bias + self.rng.normal(0.0, RATE_RAD_S))))
        seen = fix(now_ns, self.fixed(), self.covariance, self.stays) if self.tags(now_ns) else None
        if seen is not None:
            self._late.append((now_ns + LATE_NS, seen))
        while self._late and self._late[0][0] <= now_ns:
            _, event = self._late.popleft()
            self._tell(event)
            self._fixes_ns.append(event.t_ns)
        self.ring.advance(now_ns)
        self.aid.advance(now_ns)
        return seen

    def _tell(self, event: Event) -> None:
        if self.ring.add(event):
            self.aid.add(event)

    def at(self, t_ns: int) -> Belief:
        found = self.ring.at(t_ns)
        assert found is not None
        return found

    def measure(self, t_ns: int) -> AidSample:
        """The ball as seen from here."""
        x, y, psi = self.body.at.tolist()
        away = AID_BALL_M[:2] - (x, y)
        along = math.atan2(away[1], away[0])
        axes = _turned(along)
        wrong = axes @ (self._alike + self.rng.normal(0.0, RANDOM_M))
        ahead, left, up = offset_m((x, y, psi), tuple((AID_BALL_M + wrong).tolist()))
        return AidSample(t_ns, (ahead, left, up), *(upper(axes @ np.diag(s * s) @ axes.T) for s in (RANDOM_M, ALIKE_M)))

    def prior(self, seen: AidSample, now_ns: int) -> Prior | None:
        """What it says of the ball: as the kernel puts its own pose into it (own_pose.py)."""
        own = self.at(seen.t_ns)
        if not within(own, LOST_M, LOST_DEG):
            return None
        at_m, arm = _placed(own.pose, seen.offset_m)
        factor = kappa((seen.t_ns - self._sampled_ns) * 1e-9, longest_gap_s(self._fixes_ns, now_ns))
        self._sampled_ns = seen.t_ns
        random = plus(seen.random_m2, times(factor, carried(arm, own.covariance)))
        return Prior(at_m, random, seen.t_ns, plus(seen.alike_m2, carried(arm, own.stays)))

    def better(self, others: Posterior | None, now_ns: int) -> Belief | None:
        """The aided pose, as Localizer.best has it."""
        own = self.at(now_ns)
        if self.aid.needed(own, others) and (settled := self.ring.at(self.aid.begins_ns(now_ns))) is not None:
            self.aid.begin(settled)
        return self.aid.at(own, others)


def aided(seed: int, gyro: bool = False, seconds: float = AID_S) -> Row:
    """Errors of each robot's own, aided and joint pose while it knows where it is, and of the ball's place."""
    first = float(generator(seed, "aid").uniform(-math.pi, math.pi))
    divers = [Diver(seed, name, wrap(first + 2.0 * math.pi * k / len(TAGS)), gyro) for k, name in enumerate(TAGS)]
    table, joint, pending = Table(), JointFilter(len(divers)), deque[tuple[int, int, AidSample]]()
    for i, one in enumerate(divers):
        joint.begin(i, 0, one.at(0).pose, one.covariance)
    errors: dict[str, list[list[Array]]] = {key: [[] for _ in divers] for key in ("own", "aided", "joint")}
    nees: list[float] = []
    moments = 0  # of all robots
    by = [one.at(0) for one in divers]
    for now_ns in range(STEP_NS, round(seconds * S) + 1, STEP_NS):
        for i, one in enumerate(divers):
            told = one.swim(now_ns, by[i])
            joint.ask(i, one.asked)
            joint.predict(i, now_ns)
            if told is not None:
                v = told.values
                joint.add_fix(i, (v[0], v[1], v[2]), one.covariance)
            if now_ns % SAMPLE_NS == i * STEP_NS:
                seen = one.measure(now_ns)
                pending.append((now_ns + SWEPT_NS, i, seen))
                place, _ = _placed(joint.pose(i), seen.offset_m)
                joint.add_sample(i, Fix(place, seen.random_m2, seen.alike_m2), one.stays)
        while pending and pending[0][0] <= now_ns:
            _, i, seen = pending.popleft()
            prior = divers[i].prior(seen, now_ns)
            if prior is not None:
                table.measure((divers[i].name, 1), prior)
                divers[i].aid.see(Seen("ball", *seen))
        for i, one in enumerate(divers):
            own = one.at(now_ns)
            better = one.better(by_others(table, one.name), now_ns)
            by[i] = better or own
            if now_ns % (S // 4) == 0 and now_ns > 0.25 * seconds * S:
                moments += 1
                if not within(own, LOST_M, LOST_DEG):
                    continue
                truth = one.body.at
                errors["own"][i].append(own.pose[:2] - truth[:2])
                errors["aided"][i].append(by[i].pose[:2] - truth[:2])
                errors["joint"][i].append(np.array(joint.pose(i)[:2]) - truth[:2])
                if better is not None:
                    nees.append(_planar_nees(better, truth))
    ball = fuse(table.opinions())
    assert ball is not None
    off, (joint_at, _) = np.array(ball.x_m) - AID_BALL_M, joint.target
    return {
        **{f"{key}_mm": [1e3 * _rms(each) for each in found] for key, found in errors.items()},
        "known": [len(TAGS) * len(each) / moments for each in errors["own"]],
        "nees": nees,
        "target_mm": 1e3 * float(np.linalg.norm(off)),
        "target_nees": float(off @ np.linalg.solve(full(ball.cov_m2), off)) / 3.0,
        "joint_target_mm": 1e3 * float(np.linalg.norm(joint_at - AID_BALL_M)),
    }


def by_others(table: Table, name: str) -> Posterior | None:
    """As StaticTarget has it."""
    found = fuse([opinion for opinion in table.opinions() if opinion.origin != name])
    return None if found is None or found.verdict == "ambiguous" else Posterior(found.x_m, found.cov_m2)


def _placed(pose: Vector, offset: Vector) -> tuple[Vector, Vector]:
    """The place of a sample from that pose, and the arm to it."""
    east, north, _ = (_turned(pose[2]) @ offset).tolist()
    return (pose[0] + east, pose[1] + north, offset[2]), (east, north, 0.0)


def _turned(psi: float) -> Array:
    c, s = math.cos(psi), math.sin(psi)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _planar_nees(belief: Belief, truth: Array) -> float:
    e = np.array(belief.pose) - truth
    e[2] = wrap(float(e[2]))
    return float(e @ np.linalg.solve(full(plus(belief.covariance, belief.stays)), e)) / 3.0


def _squares(sigmas: Array) -> Symmetric:
    xx, yy, zz = np.square(sigmas).tolist()
    return xx, 0.0, 0.0, yy, 0.0, zz


def _rms(found: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(found), axis=1))))
