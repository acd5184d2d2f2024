"""One target as one robot knows it: messages about it, its estimator, and what was measured of it.

A robot has such a state for each target of the fleet file, and nothing passes from one to another. Each has an
iteration index of its own, which counts while the camera's turn is at this target (`TargetScheduler`): to every
protocol it looks as if there were no other.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from agent.core.config import Fleet
from agent.core.estimation.evidence import Evidence
from agent.core.estimation.evidence_table import R_FLOOR_M, inside, widest_m2
from agent.core.estimation.interface import NOTHING, Bearing, EstimateCache, Estimator, Prior, Update
from agent.core.estimation.protocols import estimator
from agent.core.estimation.track import outer
from agent.core.linear_algebra import IDENTITY, apply, inner, invert, minus, plus, times, trace
from agent.core.messages import Estimate, State, Symmetric, Vector
from agent.core.step_transaction import Revertible
from agent.core.verdict import Consistency

Knows = Literal["blind", "told", "sees"]
SEEN = 0.9  # of the frames that show the whole target, at a range that the lens reaches, the target is found in
BETWEEN_NS = 40_000_000  # from one message to a neighbour to the next, at least, where it is news: a step, at 20 Hz
HELD = 2  # iterations in a row: where the camera is slow, every other sweep comes too late, which is no change


class TargetEstimate(NamedTuple):
    """What the fleet agrees on of one target, now."""

    x_m: Vector
    v_m_s: Vector
    cov_m2: Symmetric
    seen_ns: int  # when this robot or one that it hears last measured it

    @property
    def sigma_m(self) -> float:
        """Root of the trace of the covariance of x and y."""
        return math.sqrt(self.cov_m2[0] + self.cov_m2[3])


class TargetState(Revertible):
    """What one robot keeps about one target between steps."""

    def __init__(self, fleet: Fleet, robot: str, target: str, incarnation: int, common: str = "") -> None:
        self._fleet, self._robot, self._incarnation = fleet.fleet, robot, incarnation
        self._common, self._tank_m = common, fleet.tank.size_m
        self.name = target
        self.ball = fleet.target[target]
        self.cache = EstimateCache(fleet.fleet, robot, target, fleet.robot[robot].neighbours)
        self.estimator: Estimator = estimator(fleet, robot, target, incarnation)
        self._validity_ns = round(fleet.estimation.validity_s * 1e9)

        self.prior: Prior | None = None  # measured since the last iteration
        self.bearing: Bearing | None = None  # in its stead, of a target that is pursued
        self.measured: Prior | None = None  # the newest measurement
        self.measurements = 0
        self.update: Update | None = None
        self.acquired_t: int | None = None  # iteration of the first own view
        self.knows: Knows = "blind"
        self.since_t = 0  # iteration since which `knows` has this value
        self._held = HELD  # iterations for which it has had it
        self._news: Knows = "blind"  # what was last reported of `knows`
        self._seen_ns: int | None = None  # when a robot was last known to measure it
        self.last_state: State | None = None
        self.consistency = Consistency(robot)
        self._said = dict.fromkeys(fleet.robot[robot].neighbours, 0)  # messages to each
        self._told_ns = dict.fromkeys(fleet.robot[robot].neighbours, 0)  # when each was spoken to last
        self._missed, self._looked_ns = 0.0, 0  # nats, and the exposure of the newest look that counted

    def measure(self, prior: Prior) -> None:
        """A sweep gave a position."""
        self.prior = self.measured = prior
        self.measurements += 1

    def looked(self, found: bool, t_ns: int) -> None:
        """A frame of where the target is believed to be shows it, or does not."""
        since_s = min(max((t_ns - self._looked_ns) * 1e-9, 0.0), 1.0)  # misses of neighbouring frames are one miss
        self._missed = 0.0 if found else self._missed - math.log(1.0 - SEEN) * since_s
        self._looked_ns = t_ns

    def observe(self, bearing: Bearing | None) -> None:
        """A bearing for the next iteration."""
        self.bearing = bearing

    def catch_up(self, now_ns: int) -> None:
        """Take over the iteration index of neighbours that are ahead."""
        self.estimator.adopt(self.cache.swarm_t(now_ns, self._validity_ns))

    def estimate(self, now_ns: int) -> TargetEstimate | None:
        """The posterior, to swim by. To be asked in each step: it takes note of the robots that see the target."""
        self._note_who_sees(now_ns)
        believed = self.estimator.posterior
        if believed is None or self._seen_ns is None:
            return None
        return TargetEstimate(believed.x_m, believed.v_m_s, believed.cov_m2, self._seen_ns)

    def show(self, state: State) -> State:
        """Remember the newest state that was shown."""
        self.last_state = state
        return state

    def iterate(self, now_ns: int) -> bool:
        """One iteration of the protocol. Returns whether `knows` is news: it has had its value for HELD iterations, and
        the last news was another one."""
        if self.prior is None and self.bearing is not None and isinstance(self.estimator, Evidence):
            self.update = self.estimator.tick(self.bearing, self.cache, now_ns)
        else:
            self.update = self.estimator.tick(self.prior, self.cache, now_ns)
        self.consistency.update(self.update.explain, self.prior is None, now_ns)
        sees = self._note_who_sees(now_ns)
        nats = {self._robot: self._missed, **self.cache.missed(now_ns)}
        self.consistency.missed(nats, sees, self._seen_ns, now_ns)
        self.prior = self.bearing = None
        knew, self.knows = self.knows, "blind"
        if self.estimator.valid:
            self.knows = "sees"
        elif self.estimator.posterior is not None:
            self.knows = "told"
        if self.estimator.valid and self.acquired_t is None:
            self.acquired_t = self.update.t
        if self.knows != knew:
            self.since_t, self._held = self.update.t, 0
        self._held += 1
        if self._held < HELD or self.knows == self._news:
            return False
        self._news = self.knows
        return True

    def _note_who_sees(self, now_ns: int) -> list[str]:
        """The robots that are known to see the target now."""
        sees = [name for name, _ in self.cache.usable(now_ns, self._validity_ns)]
        sees += [self._robot] if self.estimator.valid else []
        self._seen_ns = now_ns if sees else self._seen_ns
        return sees

    def has_news(self, neighbour: str, now_ns: int) -> bool:
        """Whether a neighbour should hear of this target before the next round."""
        return now_ns - self._told_ns[neighbour] >= BETWEEN_NS and self.estimator.news(neighbour)

    def say(self, neighbour: str, now_ns: int, between: bool = False) -> Estimate:
        """The message to a neighbour; without news it is still the heartbeat. between: two rounds, the news alone."""
        word = self.estimator.say(neighbour, now_ns, between)
        self._said[neighbour] += 1
        self._told_ns[neighbour] = now_ns
        if word.x_m is None or not inside(word.x_m, self._tank_m):  # no robot would believe it
            word = word._replace(x_m=None, cov_m2=None)
        return Estimate(
            fleet=self._fleet,
            src=self._robot,
            dst=neighbour,
            incarnation=self._incarnation,
            seq=self._said[neighbour],
            sent_ns=now_ns,
            target=self.name,
            t=self.estimator.t,
            valid=self.estimator.valid,
            common=self._common,
            echo=self.cache.echo(neighbour, now_ns),
            missed=self._missed,
            **word._replace(cov_m2=sayable(word.cov_m2, self._tank_m))._asdict(),
        )


def sayable(covariance_m2: Symmetric | None, tank_m: Vector) -> Symmetric | None:
    """A covariance as it can be sent: never wider than that the target is in the tank."""
    if covariance_m2 is None:
        return None
    excess = trace(covariance_m2) / widest_m2(tank_m)
    return covariance_m2 if excess <= 1.0 else times(1.0 / excess, covariance_m2)


# --- bearing ---
# A frame that shows the target gives a bearing: it places the target across the ray as well as the box, along it not at
# all.
#
# E: two unit vectors across the ray; V = sigma^2 u^2 I + E' P E, with u the range that is believed, which sets the
# weight alone, and P what the robot's own pose adds. Then Lam = E V^-1 E' is of rank 2, and Lam (o + s n) the same for
# any s.
#
# The ray's own direction n errs by sigma from frame to frame, and lines that all go through one camera then seem to
# meet there: along the true direction n0, n0' Lam n0 is 2/u^2 on average, out of nothing, and N frames from one place
# would know the range to u / sqrt(2 N). So E is taken across the direction in which the target is believed to be, as an
# extended Kalman filter linearizes about its prediction; the ray's own counts where nothing is believed.

NEAR = math.cos(0.2)  # cosine of the angle of ray and belief; beyond it a wrong range would misplace the ray


def bearing(
    origin_m: Vector,
    direction: Vector,
    range_m: float,
    sigma_rad: float,
    t_ns: int,
    pose_m2: Symmetric = NOTHING,
    range_sigma_m: float | None = None,
    believed: Vector | None = None,
) -> Bearing:
    """The bearing of a camera at origin_m along `direction`, world frame; its length does not matter.

    pose_m2: covariance of the place at that range by errors of the robot's own pose, with what their memory makes of
    them. range_sigma_m: of a range by size or focus; None: there is none. believed: direction from there in which the
    target is believed to be, for want of a range. None, or one far off the ray: the ray's own direction counts. Raises
    ValueError without a direction or a range.
    """
    if not (any(direction) and range_m > 0.0):
        raise ValueError(f"a bearing needs a direction and a range, not {direction} and {range_m} m")
    n = unit(direction)
    x_m = origin_m[0] + range_m * n[0], origin_m[1] + range_m * n[1], origin_m[2] + range_m * n[2]
    own = max(sigma_rad * range_m, R_FLOOR_M) ** 2
    if range_sigma_m is not None:  # a place, as good across as along
        along = outer(n)
        placed_m2 = plus(times(own, minus(IDENTITY, along)), times(max(range_sigma_m, R_FLOOR_M) ** 2, along))
        return Bearing(x_m, invert(plus(placed_m2, pose_m2)), t_ns)
    if believed is not None and any(believed) and inner(n, towards := unit(believed)) > NEAR:
        n = towards
    e, f = _across(n)
    pe, pf = apply(pose_m2, e), apply(pose_m2, f)
    a, b, d = own + inner(e, pe), inner(e, pf), own + inner(f, pf)
    det = a * d - b * b
    information = plus(plus(times(d / det, outer(e)), times(a / det, outer(f))), times(-b / det, _both(e, f)))
    return Bearing(x_m, information, t_ns)


def ranged(
    line: Bearing,
    origin_m: Vector,
    direction: Vector,
    range_m: float,
    range_sigma_m: float,
    believed: Vector | None = None,
) -> Bearing:
    """`line`, a bearing from origin_m without a range, with what is known of its range: too little to place the target
    across the ray by it, enough to be used along it.

    It counts along the axis that the line says nothing about, so that many such lines from one place know no more of
    the range than is put in here. direction, believed: as for the bearing.
    """
    n = unit(direction)
    if believed is not None and any(believed) and inner(n, towards := unit(believed)) > NEAR:
        n = towards
    x, y, z = line.x_m
    along_m = inner((x - origin_m[0], y - origin_m[1], z - origin_m[2]), n)
    by_m = range_m - along_m
    information = plus(line.information, times(1.0 / max(range_sigma_m, R_FLOOR_M) ** 2, outer(n)))
    return Bearing((x + by_m * n[0], y + by_m * n[1], z + by_m * n[2]), information, line.t_ns)


def unit(v: Vector) -> Vector:
    """Of length 1; v is not 0."""
    length = math.sqrt(inner(v, v))
    return v[0] / length, v[1] / length, v[2] / length


def _across(n: Vector) -> tuple[Vector, Vector]:
    """Two unit vectors, at right angles to n and to each other."""
    x, y, z = n
    if abs(z) < 0.9:  # the first one is level
        level = math.sqrt(x * x + y * y)
        e = -y / level, x / level, 0.0
    else:
        upright = math.sqrt(y * y + z * z)
        e = 0.0, -z / upright, y / upright
    return e, (y * e[2] - z * e[1], z * e[0] - x * e[2], x * e[1] - y * e[0])


def _both(e: Vector, f: Vector) -> Symmetric:
    """e f' + f e'"""
    return (
        2.0 * e[0] * f[0],
        e[0] * f[1] + e[1] * f[0],
        e[0] * f[2] + e[2] * f[0],
        2.0 * e[1] * f[1],
        e[1] * f[2] + e[2] * f[1],
        2.0 * e[2] * f[2],
    )
