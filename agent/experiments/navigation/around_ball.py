"""Robots around a ball, robots whose ways cross, and robots that rarely see tags and are aided by a ball.

`ball`: three robots hold their places around a ball and say where it is. The bound is the error of `JointFilter`, which
has every measurement of all of them. `crossing`: how near robots come to each other. `aided`: how much a ball that
others have located tells a robot of where it is itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from agent.capabilities.swim.aided_pose import Aid, Seen, offset_m
from agent.capabilities.swim.barrier import Reference
from agent.capabilities.swim.behaviour import wanted_velocity, wrench
from agent.capabilities.swim.event_ring import Event, EventRing, asked, fix, rate
from agent.capabilities.swim.localizer import LOST_DEG, LOST_M, within
from agent.capabilities.swim.pose_filter import RATE_RAD_S, Belief, Drift, Hull, begin
from agent.capabilities.swim.swim import swimmer_of
from agent.core.config import Goto, Look, Pose
from agent.core.estimation.evidence_table import Table
from agent.core.estimation.fuse import fuse
from agent.core.estimation.interface import Posterior, Prior
from agent.core.linear_algebra import plus, times, upper, wrap
from agent.core.messages import Symmetric, Vector
from agent.core.ranging.fix import Fix, carried, kappa, longest_gap_s
from agent.experiments.experiment import Row
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import PULL, TANK, PlanarBodies, PlanarBody, drawn_hull, twin_bodies
from agent.experiments.navigation.joint_filter import Array, JointFilter, full, joint_filter_of
from agent.experiments.navigation.swimmers import Notes, Sample, Swimmers
from hw.twin.scene import generator

ROBOTS, AROUND_M, SECONDS = 3, 0.75, 60.0
BALL_M = (0.5 * TANK.size_m[0], 0.5 * TANK.size_m[1], 0.07)
BALL_LOOK = Look(tilt_deg=-20.0)


def ball(seed: int, seconds: float = SECONDS) -> Row:
    """Errors of the robots and of the bound at the end, and both normalised errors squared, a third."""
    rng = generator(seed, "ball")
    names, first = [f"r{i + 1}" for i in range(ROBOTS)], float(rng.uniform(-math.pi, math.pi))
    robots = {}
    for k, name in enumerate(names):
        way = first + 2.0 * math.pi * k / ROBOTS + float(rng.uniform(-0.2, 0.2))
        x, y = BALL_M[0] + AROUND_M * math.cos(way), BALL_M[1] + AROUND_M * math.sin(way)
        pose = Pose(x_m=x, y_m=y, yaw_deg=math.degrees(wrap(way + math.pi)))
        others = tuple(other for other in names if other != name)
        robots[name] = basin.robot(name, pose, None, BALL_LOOK, others)
    fleet = basin.fleet(robots, seed)
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies, BALL_M)
        notes = Notes(swimmers)
        for _ in range(round(seconds * 20.0)):
            swimmers.step()
            notes.take()
        own = [swimmers.agents[name].measuring.current.estimator.posterior for name in names]
    joint = joint_filter_of(notes.measured, fleet, list(swimmers.calibrations.values()))
    at, covariance = joint.target
    errors = [np.array(known.x_m) - BALL_M for known in own if known is not None]
    return {
        "robots": ROBOTS,
        "told": len(errors),
        "error_mm": [1e3 * float(np.linalg.norm(e)) for e in errors],
        "nees": [_nees(e, full(known.cov_m2)) for e, known in zip(errors, filter(None, own), strict=True)],
        "bound_mm": 1e3 * float(np.linalg.norm(at - BALL_M)),
        "bound_nees": _nees(at - BALL_M, covariance),
        "bound_sigma_mm": 1e3 * math.sqrt(float(np.trace(covariance))),
        "samples": sum(isinstance(one.what, Sample) for one in notes.measured),
    }


def _nees(e: Array, covariance: Array) -> float:
    """A third of the normalised error squared: 1 where it is honest."""
    return float(e @ np.linalg.solve(covariance, e)) / 3.0


# --- crossing: how near robots come to each other, while all of them swim across the basin ---
# Distances are centre to centre and by the truth. Each robot starts where another one shall be: their ways cross. They
# are neighbours, all of all, and what they say arrives. The crew arms them when all have found themselves: no robot
# keeps clear of one that cannot say where it is.

CROSSING_ROBOTS, CROSSING_S = 10, 30.0
FIND_S = 30.0  # in the hands of the crew, at most
APART_M = 0.45  # places that are told; the fleet file demands 0.36
CLEAR_M = 0.22  # from walls


def crossing(seed: int, robots: int = CROSSING_ROBOTS, seconds: float = CROSSING_S) -> Row:
    """Least distance (m) of any two, and the share of robots that are within 5 cm of their goals at the end."""
    rng = generator(seed, "crossing")
    starts = places(rng, robots)
    goals = np.roll(starts, 1 + int(rng.integers(robots - 1)), axis=0)  # no robot stays where it is
    names = [f"r{i + 1}" for i in range(robots)]
    fleet = basin.fleet(
        {
            name: basin.robot(
                name,
                Pose(x_m=float(start[0]), y_m=float(start[1]), yaw_deg=float(rng.uniform(-180.0, 180.0))),
                Goto(x_m=float(goal[0]), y_m=float(goal[1])),
                neighbours=tuple(other for other in names if other != name),
            )
            for name, start, goal in zip(names, starts, goals, strict=True)
        },
        seed,
    )
    bodies = PlanarBodies(fleet)
    swimmers = Swimmers(fleet, bodies)
    bodies.armed = False
    for _ in range(round(FIND_S * 20.0)):
        swimmers.step()
        own = (swimmer_of(agent.capabilities) for agent in swimmers.agents.values())
        if all(swimmer is not None and not swimmer.lost for swimmer in own):
            break
    bodies.armed = True
    least = math.inf
    paths = []
    for _ in range(round(seconds * 20.0)):
        swimmers.step()
        here = np.array([swimmers.place(name)[:2] for name in names])
        least = min(least, float(np.linalg.norm(here[:, None] - here[None], axis=2)[np.triu_indices(robots, 1)].min()))
        paths.append(here)
    arrived = np.linalg.norm(paths[-1] - goals, axis=1) < 0.05
    return {"robots": robots, "least_m": least, "arrived": float(arrived.mean()), "path": np.array(paths)}


def places(rng: np.random.Generator, robots: int) -> Array:
    """Places (robots, 2) in the basin, APART_M and more from each other; a draw that gets stuck starts again."""
    low, high = np.full(2, CLEAR_M), np.array(TANK.size_m[:2]) - CLEAR_M
    while True:
        found: list[Array] = []
        for _ in range(200):
            place = rng.uniform(low, high)
            if all(np.linalg.norm(place - other) >= APART_M for other in found):
                found.append(place)
            if len(found) == robots:
                return np.array(found)


# --- aid: robots that rarely see tags, around a ball that others have located ---
# In the plane, with the kernel's filters, pilot and evidence; bodies, fixes and sightings are drawn, and everything
# said is heard at once. Nothing else tells a robot how it moves: no points to follow. The joint filter, which knows
# all that all measured, is what can be had; it has no gyro.

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
        """What it says of the ball, with the errors of its own pose in it as the kernel puts them (`carried`)."""
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
    """What others than `name` make of it, as StaticTarget has it."""
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
    return _nees(e, full(plus(belief.covariance, belief.stays)))


def _squares(sigmas: Array) -> Symmetric:
    xx, yy, zz = np.square(sigmas).tolist()
    return xx, 0.0, 0.0, yy, 0.0, zz


def _rms(found: list[Array]) -> float:
    return float(np.sqrt(np.mean(np.sum(np.square(found), axis=1))))
