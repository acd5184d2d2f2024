"""What a fleet notices of what is wrong: how far off it is then, what it says of itself, and after how long."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from random import Random
from typing import Any, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from agent.core.attitude import TARED, zeros
from agent.core.config import CAREFUL, Estimation, Fleet, Look, Orbit, Pose, Protocol, Robot, Tank, Target
from agent.core.estimation.interface import Prior
from agent.core.estimation.protocols import shared_of
from agent.core.linear_algebra import difference, distance2, full, plus, upper, wrap
from agent.core.messages import Estimate, Vector, Verdict
from agent.core.ranging.camera_model import Calibration
from agent.core.target_state import TargetState
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK as BASIN
from agent.experiments.navigation.basin import PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers
from agent.robot.step import Agent
from hw.twin.physics.sensors import DRIFT_M_S, drifted_s, seems

# --- a fleet that agrees while something is wrong ---
# A fleet that agrees on a target while something is wrong: its kernels' own targets, links that delay, and clocks.
#
# What each robot measures is drawn; nothing is rendered. A step takes 50 ms, as in the agents. Messages are those that
# the agents send, not encoded.

STEP_NS, SAY_STEPS, LOOK_STEPS = 50_000_000, 2, 10  # robots speak at 10 Hz, and look at 2 Hz
START_NS = 10**18
TANK_M = (3.0, 2.0, 1.0)
MIDDLE_M: NDArray[np.float64] = np.array([1.5, 1.0, 0.4])
STAND_M = 0.6  # of the robots around the middle
ALONG_M, ACROSS_M = 0.003, 0.0012  # of a sample, in and across its line of sight
STAYS_M = 0.001  # of each robot's own pose and calibration, an axis
CALLIPERS_M = 0.0001  # of the ball's radius
LATE_S = 0.1  # from the exposure to the step that knows of it
BALL, FISH = (
    Target(radius_m=0.05, radius_sigma_m=CALLIPERS_M),
    Target(detector="creature", length_m=0.1, speed_m_s=0.15, turn_s=3.0),
)

LONGEST_S = 120  # of a fish's path
SWIMS_LEVEL = np.array([1.0, 1.0, 0.2])  # shares of its motion

Array = NDArray[np.float64]
Beliefs = Callable[[int, float], Iterator["Belief"]]  # by seed and seconds
Path = Callable[[float], Array | None]  # of the target, by seconds since the start; None: it is gone


def no_delay(i: int, j: int, now_s: float) -> float:
    return 0.0


def right_clock(i: int, now_s: float) -> float:
    return 0.0


def never(i: int, now_s: float) -> bool:
    return False


class Case(NamedTuple):
    """What is there, and what is wrong."""

    path: Path
    target: Target = BALL
    sees: tuple[bool, ...] = (True, True, True)  # of each robot, whether it sees the target
    period_s: float = 1.0  # of its samples
    line: bool = False  # robots are linked in a line; else all with all
    delay_s: Callable[[int, int, float], float] = no_delay  # of the way from robot i to robot j
    clock_s: Callable[[int, float], float] = right_clock  # by which the clock of robot i is ahead
    loss: float = 0.0
    hidden: Callable[[int, float], bool] = never  # whether robot i does not see it though it is there
    long: tuple[float, ...] = ()  # by which share the ranges of each robot are long, beside the budget; beyond: 0
    spread_rad: float = 2.0 * math.pi  # over which the robots stand around the target
    offset_m: Callable[[int, float], Array] | None = None  # what robot i has wrong, and does not know of
    on_s: float | None = None  # how long the control modules were on before; None: their sensors do not drift
    protocol: Protocol = "evidence"


class Belief(NamedTuple):
    """One robot at one time."""

    s: float
    robot: int
    error_m: float | None  # None: it knows nothing, or the target is gone
    sigma_m: float | None  # root of the trace
    nees: float | None
    verdict: Verdict
    causes: tuple[str, ...]


def dive(case: Case, seconds: float, seed: int) -> Iterator[Belief]:
    """What each robot believes, every half second."""
    rng, random = np.random.default_rng((seed, 49)), Random(seed)
    names = [f"r{k}" for k in range(len(case.sees))]
    fleet = fleet_of(case, names)
    stands, long = stand(len(names), case.spread_rad), (*case.long, *[0.0] * len(names))
    shared = shared_of(fleet, "it")
    stays = rng.normal(0.0, STAYS_M, (len(names), 3)) + rng.multivariate_normal(np.zeros(3), full(shared.place_m2))
    of_all = float(rng.normal(0.0, shared.scale))
    drift = None if case.on_s is None else Drift(case.on_s, stands, seed)
    clocks = [lambda ns, i=i: START_NS + ns + round(case.clock_s(i, ns * 1e-9) * 1e9) for i in range(len(names))]
    states = [TargetState(fleet, name, "it", clocks[k](0)) for k, name in enumerate(names)]
    phase = [float(rng.uniform(0.0, case.period_s)) for _ in names]
    due_s = list(phase)
    iteration_ns = round(min(fleet.estimation.iteration_s, case.period_s) * 1e9)
    post: list[tuple[int, int, int, Estimate]] = []  # when it arrives, its number, at whom
    iterated, sent = [0] * len(names), 0
    for step in range(1, round(seconds * 1e9) // STEP_NS + 1):
        ns, s = step * STEP_NS, step * STEP_NS * 1e-9
        while post and post[0][0] <= ns:
            at_ns, _, j, estimate = heapq.heappop(post)
            states[j].estimator.hear(states[j].cache.put(estimate.src, estimate, clocks[j](at_ns)))
        for i, state in enumerate(states):
            now_ns = clocks[i](ns)
            if s >= due_s[i] + LATE_S:
                if case.sees[i] and not case.hidden(i, due_s[i]) and (at := case.path(due_s[i])) is not None:
                    off = stays[i] + (of_all + long[i]) * (at - stands[i])
                    off = off if case.offset_m is None else off + case.offset_m(i, due_s[i])
                    found = sample(at, stands[i], off, clocks[i](round(due_s[i] * 1e9)), rng)
                    state.measure(found if drift is None else drift.of(found, i, due_s[i]))
                due_s[i] += case.period_s
            if ns - iterated[i] >= iteration_ns or (state.prior is not None and ns - iterated[i] >= iteration_ns // 2):
                iterated[i] = ns
                state.catch_up(now_ns)
                state.iterate(now_ns)
        for i, state in enumerate(states) if step % LOOK_STEPS == 0 else ():
            if case.sees[i] and state.estimator.posterior is not None:
                state.looked(case.path(s) is not None and not case.hidden(i, s), clocks[i](ns))
        for i, state in enumerate(states) if step % SAY_STEPS == 0 else ():
            for neighbour in fleet.robot[names[i]].neighbours:
                sent += 1
                estimate = state.say(neighbour, clocks[i](ns))
                j = names.index(neighbour)
                if random.random() >= case.loss:
                    at_ns = ns + round(case.delay_s(i, j, s) * 1e9)
                    heapq.heappush(post, (at_ns, sent, j, estimate))
        if step % 10 == 0:
            yield from (belief(state, k, s, clocks[k](ns), case.path(s)) for k, state in enumerate(states))


def by_pressure(tilt_rad: float, height_m: float, arm_m: Array) -> Array:
    """Covariance of what these standard deviations move at the end of an arm."""
    turns = np.cross(np.eye(3)[:2], arm_m)
    return np.asarray(tilt_rad**2 * turns.T @ turns + np.diag((0.0, 0.0, height_m**2)))


class Drift:
    """What pressure sensors that warm up make wrong of where robots see things: each of four by itself."""

    def __init__(self, on_s: float, stands: Array, seed: int) -> None:
        """on_s: how long they had been on before the dive."""
        self._drift_m_s = DRIFT_M_S * np.random.default_rng((seed, 53)).standard_normal((len(stands), 4))
        self._on_s, self._stands = on_s, stands

    def of(self, sample: Prior, i: int, s: float) -> Prior:
        """A sample of robot i at s with that in it, and what it says of it."""
        on_s, arm = self._on_s + s, np.array(sample.x_m) - self._stands[i]
        deeper_m, ahead, left = seems(self._drift_m_s[i] * drifted_s(on_s))
        x, y, z = (np.array(sample.x_m) + np.cross((-left, ahead, 0.0), arm)).tolist()
        now, cold = zeros(CAREFUL, on_s), TARED  # what a tare leaves is in STAYS_M
        height_m, tilt_rad = (math.sqrt(a * a - b * b) for a, b in zip(now[:2], cold[:2], strict=True))
        return sample._replace(
            x_m=(x, y, z - deeper_m),
            systematic_m2=plus(sample.systematic_m2, upper(by_pressure(tilt_rad, height_m, arm))),
            drift_m2_s2=upper(by_pressure(now.tilt_rad_s, now.height_m_s, arm)),
        )


def sample(at: Array, stand_m: Array, off_m: Array, t_ns: int, rng: np.random.Generator) -> Prior:
    """What a robot there measures of a target there."""
    ray = at - stand_m
    along = np.outer(ray, ray) / float(ray @ ray)
    random_m2 = ALONG_M**2 * along + ACROSS_M**2 * (np.eye(3) - along)
    x, y, z = (at + off_m + np.linalg.cholesky(random_m2) @ rng.standard_normal(3)).tolist()
    u, v, w = ray.tolist()
    return Prior((x, y, z), upper(random_m2), t_ns, upper(STAYS_M**2 * np.eye(3)), (u, v, w))


def belief(state: TargetState, robot: int, s: float, now_ns: int, truth_m: Array | None) -> Belief:
    known, told = state.estimate(now_ns), state.consistency.verdict(now_ns)
    if known is None or truth_m is None:
        return Belief(s, robot, None, None, None, *told)
    e, P = np.array(known.x_m) - truth_m, full(known.cov_m2)
    nees = float(e @ np.linalg.solve(P, e))
    return Belief(s, robot, float(np.linalg.norm(e)), math.sqrt(np.trace(P)), nees, *told)


def stand(robots: int, spread_rad: float = 2.0 * math.pi) -> Array:
    """Where cameras are, around the middle; (N, 3)."""
    angle = spread_rad * np.arange(robots) / robots
    around = np.column_stack([STAND_M * np.cos(angle), STAND_M * np.sin(angle), np.full(robots, 0.05)])
    return np.asarray(MIDDLE_M + around)


def fleet_of(case: Case, names: Sequence[str]) -> Fleet:
    """Their fleet file; no device of it is ever opened."""

    def near(k: int) -> tuple[str, ...]:
        return tuple(name for j, name in enumerate(names) if j != k and (not case.line or abs(j - k) == 1))

    return Fleet(
        fleet="doubt",
        tank=Tank(size_m=TANK_M),
        target={"it": case.target},
        estimation=Estimation(iteration_s=1.0, protocol=case.protocol),
        robot={
            name: Robot(
                neighbours=near(k),
                listen="",
                serial="",
                camera="",
                pose=Pose(x_m=0.0, y_m=0.0, yaw_deg=0.0),
                calibration="",
            )
            for k, name in enumerate(names)
        },
    )


# --- a robot that swims by a map that is wrong ---
# Its drawn frames show the tags where they are; its own files say otherwise. It swims round a point, facing it.

Wrong = Callable[
    [Fleet, Calibration, np.random.Generator], tuple[Fleet, Calibration]
]  # what its files say, by the truth
ROUND = Orbit(x_m=0.5 * BASIN.size_m[0], y_m=0.5 * BASIN.size_m[1], radius_m=0.5)


AT_WALLS = Look(tilt_deg=-15.0)  # several tags in most frames


def by_tags(wrong: Wrong, look: Look = AT_WALLS) -> Beliefs:
    """What it believes of its own x, y and yaw, every half second; the errors are those of x and y."""

    def beliefs(seed: int, seconds: float) -> Iterator[Belief]:
        start = Pose(x_m=ROUND.x_m - ROUND.radius_m, y_m=ROUND.y_m, yaw_deg=0.0)
        fleet = basin.fleet({"r1": basin.robot("r1", start, ROUND, look)}, seed)
        one = Swimmers(fleet, PlanarBodies(fleet))
        said, known = wrong(fleet, one.calibrations["r1"], np.random.default_rng((seed, 52)))
        one.agents["r1"] = Agent(said, "r1", known, basin.START_NS)
        for s in one.each_step(seconds):
            if one.steps % 10 == 0:
                yield own_belief(one, s)

    return beliefs


def own_belief(one: Swimmers, s: float) -> Belief:
    swimmer = one.swimmer("r1")
    fault, here = swimmer.localizer.fault(), swimmer.localizer.at(one.now_ns)
    told = () if fault is None else (fault,)
    word: Verdict = "consistent" if fault is None else "contradicted" if "contradicted" in fault else "suspect"
    if here is None:
        return Belief(s, 0, None, None, None, word, told)
    x, y, yaw = difference(here.pose, one.place("r1"))
    P = plus(here.covariance, here.stays)
    return Belief(s, 0, math.hypot(x, y), math.sqrt(P[0] + P[3]), distance2(P, (x, y, wrap(yaw))), word, told)


def moved_tags(sigma_m: float, shift_m: float = 0.0) -> Wrong:
    """Each tag is elsewhere by sigma_m in each coordinate of its face, all of them by shift_m along x."""

    def wrong(fleet: Fleet, known: Calibration, rng: np.random.Generator) -> tuple[Fleet, Calibration]:
        assert fleet.landmarks is not None
        tags = []
        for tag in fleet.landmarks.tag:
            across = np.array([tag.face[0] != "x", tag.face[0] != "y", tag.face != "floor"])
            x, y, z = (np.array(tag.position_m) + across * rng.normal(0.0, sigma_m, 3) + (shift_m, 0.0, 0.0)).tolist()
            tags.append(replace(tag, position_m=(x, y, z)))
        return replace(fleet, landmarks=replace(fleet.landmarks, tag=tuple(tags))), known

    return wrong


def small_tags(fleet: Fleet, known: Calibration, rng: np.random.Generator) -> tuple[Fleet, Calibration]:
    """They are printed 2 % smaller than the file says."""
    assert fleet.landmarks is not None
    return replace(fleet, landmarks=replace(fleet.landmarks, size_m=1.02 * fleet.landmarks.size_m)), known


def high_water(fleet: Fleet, known: Calibration, rng: np.random.Generator) -> tuple[Fleet, Calibration]:
    return replace(fleet, tank=replace(fleet.tank, surface_m=fleet.tank.surface_m - 0.01)), known


# --- paths ---


def rests(s: float) -> Array:
    return MIDDLE_M


def swims(seed: int, speed_m_s: float = 0.15, turn_s: float = 3.0) -> Path:
    """A fish: level, at about that speed, inside the tank."""
    rng, dt, walls_m = np.random.default_rng((seed, 50)), 0.05, np.array([0.5, 0.5, 0.1])
    x, v = MIDDLE_M.copy(), np.array([speed_m_s, 0.0, 0.0])
    places = []
    for _ in range(20 * LONGEST_S):
        places.append(x)
        v = v - v / turn_s * dt + speed_m_s * math.sqrt(dt / turn_s) * SWIMS_LEVEL * rng.standard_normal(3)
        v = v - dt * np.clip((x - MIDDLE_M) / walls_m, -1.5, 1.5) * (np.abs(x - MIDDLE_M) > walls_m) * speed_m_s
        x = x + v * dt

    def at(s: float) -> Array:
        k = min(int(s / dt), len(places) - 2)
        return np.asarray(places[k] + (s / dt - k) * (places[k + 1] - places[k]))

    return at


def moved_at(when_s: float, by: Vector) -> Path:
    """A ball that a hand moves."""
    return lambda s: MIDDLE_M + (np.array(by) if s >= when_s else 0.0)


# --- the claim ---

WRONG_S = 40.0  # from then on something is wrong, where it is not so from the start
NOTICED_S = 10.0  # so long it may go unnoticed
TOO_FAR = 9.0  # NEES beyond which a belief is wrong: 3 is honest


class Doubt(NamedTuple):
    """One row of the table."""

    words: str
    beliefs: Beliefs
    from_start: bool = False  # wrong from the first message on
    shows: bool = True  # False: what all robots have alike is in no sample of theirs


def ball(**about: Any) -> Beliefs:
    return lambda seed, seconds: dive(Case(**{"path": rests, "target": BALL, **about}), seconds, seed)


def fish(**about: Any) -> Beliefs:
    seen = {"target": FISH, "period_s": 0.1, "sees": (True, True, False)}
    return lambda seed, seconds: dive(Case(**{"path": swims(seed), **seen, **about}), seconds, seed)


def late(delay_s: float) -> Callable[[int, int, float], float]:
    return lambda i, j, s: delay_s


def knocked(i: int, s: float) -> Array:
    return np.array([0.06 * (i == 0 and s > WRONG_S), 0.0, 0.0])


def gone(s: float) -> Array | None:
    return rests(s) if s < WRONG_S else None


def creeps(s: float) -> Array:
    return np.asarray(MIDDLE_M + np.array([0.0, 1e-3 * max(s - WRONG_S, 0.0), 0.0]))


def crooked(seed: int, seconds: float) -> Iterator[Belief]:
    """Each of fifteen robots is 3 mm off, three times as far as it reckons with."""
    off = np.random.default_rng((seed, 51)).normal(0.0, 0.003, (15, 3))
    return dive(Case(rests, sees=(True,) * 15, offset_m=lambda i, s: np.asarray(off[i])), seconds, seed)


def off_by(x: float, z: float) -> Callable[[int, float], Array]:
    """All robots."""
    return lambda i, s: np.array([x, 0.0, z])


def apart(i: int, s: float) -> Array:
    return np.array([0.4 * i, 0.0, 0.0])


SIDE_RAD, ONE, LINE = math.radians(60.0), (True, False, False), (True, False, False, False, False)
BY_60, BY_20 = moved_at(WRONG_S, (0.0, 0.06, 0.0)), moved_at(WRONG_S, (0.0, 0.02, 0.0))
ROWS = {
    "ball": Doubt("a ball at rest, nothing wrong", ball(), True),
    "fish": Doubt("a fish, nothing wrong", fish(), True),
    "late-0.3": Doubt("a fish; all messages 0.3 s late", fish(delay_s=late(0.3)), True),
    "late-2": Doubt("a fish; all messages 2 s late", fish(delay_s=late(2.0)), True),
    "late-one-way": Doubt(
        "a fish; 0.6 s late to the blind robot alone", fish(delay_s=lambda i, j, s: 0.6 * (j == 2)), True
    ),
    "late-line": Doubt(
        "a fish; five in a line, the first sees, 0.3 s a hop", fish(delay_s=late(0.3), line=True, sees=LINE), True
    ),
    "lost": Doubt("a fish that all lose", fish(hidden=lambda i, s: s > WRONG_S)),
    "moved-60": Doubt("the ball is moved by 60 mm", ball(path=BY_60)),
    "moved-20": Doubt("the ball is moved by 20 mm", ball(path=BY_20)),
    "moved-60-one": Doubt("the ball is moved by 60 mm, one robot sees it", ball(path=BY_60, sees=ONE)),
    "creep": Doubt("the ball creeps by 1 mm/s", ball(path=creeps)),
    "removed": Doubt("the ball is taken away", ball(path=gone)),
    "removed-one": Doubt("the ball is taken away, one robot saw it", ball(path=gone, sees=ONE)),
    "knocked": Doubt("one of three robots is knocked by 60 mm", ball(offset_m=knocked)),
    "two-balls": Doubt("two robots see two balls, 0.4 m apart", ball(sees=(True, True), offset_m=apart), True),
    "long-2": Doubt("all ranges are 2 % long, robots all around", ball(long=(0.02,) * 3), True),
    "long-2-side": Doubt("the same, robots on one side", ball(long=(0.02,) * 3, spread_rad=SIDE_RAD), True),
    "crooked-15": Doubt("fifteen robots, each 3 mm off", crooked, True),
    "level-10": Doubt("the water is 10 mm higher than all believe", ball(offset_m=off_by(0.0, 0.01)), True, False),
    "survey-10": Doubt("the survey is 10 mm off for all", ball(offset_m=off_by(0.01, 0.0)), True, False),
    "cold": Doubt("a ball at rest, pressure sensors from cold, nothing else wrong", ball(on_s=0.0), True),
    "warm": Doubt("the same, sensors that have drifted for ten minutes", ball(on_s=600.0), True),
    "paper": Doubt("a ball at rest, the paper's protocol, nothing wrong", ball(protocol="paper"), True),
    "table-3": Doubt("the focus table of one robot is 3 % long", ball(long=(0.03,)), True),
    "map": Doubt("own pose by tags, nothing wrong", by_tags(moved_tags(0.0)), True),
    "map-5": Doubt("own pose; each tag 5 mm elsewhere than the map says", by_tags(moved_tags(0.005)), True),
    "map-5-one": Doubt(
        "own pose; the same, one tag in sight", by_tags(moved_tags(0.005), basin.FLOOR_LOOK), True, False
    ),
    "map-10": Doubt("own pose; each tag 10 mm elsewhere", by_tags(moved_tags(0.01)), True),
    "map-shifted": Doubt("own pose; all tags 10 mm aside", by_tags(moved_tags(0.0, 0.01)), True, False),
    "tags-small": Doubt("own pose; tags printed 2 % small", by_tags(small_tags), True),
    "water-10": Doubt("own pose; water 10 mm higher", by_tags(high_water), True),
}


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seconds: float = 75.0


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One dive: its beliefs after what is wrong had its time, and the first word other than `consistent`."""
    of = ROWS[case]
    since_s = 15.0 if of.from_start else WRONG_S  # a quarter of a minute: the fleet settles
    first: Belief | None = None
    late_on = []
    for belief in of.beliefs(seed, settings.seconds):
        if first is None and belief.s > since_s and belief.verdict != "consistent":
            first = belief
        if belief.s > since_s + NOTICED_S:
            late_on.append(belief)
    known = [each for each in late_on if each.nees is not None]
    silent = [each for each in late_on if each.verdict == "consistent"]
    if known:  # robots whose beliefs are worse than they say in the mean, as far as they say nothing
        wrong = {each.robot for each in known if _mean_nees(silent, each.robot) > TOO_FAR}
        silent = [each for each in silent if each.robot in wrong]
    return [
        {
            "error_mm": 1e3 * float(np.mean([each.error_m for each in known])) if known else None,
            "sigma_mm": 1e3 * float(np.mean([each.sigma_m for each in known])) if known else None,
            "nees": float(np.mean([each.nees for each in known])) if known else None,
            "silent": len(silent) / max(len(late_on), 1),
            "said_s": None if first is None else round(first.s - since_s, 3),
            "word": "" if first is None else first.verdict,
            "cause": "" if first is None else first.causes[0],
        }
    ]


def _mean_nees(beliefs: Sequence[Belief], robot: int) -> float:
    found = [each.nees for each in beliefs if each.robot == robot and each.nees is not None]
    return float(np.mean(found)) if found else 0.0


def summary(rows: Rows) -> dict[str, Value]:
    """Of a case: means, when half of the dives had said something, and the dives that are wrong in silence."""
    found: dict[str, Value] = {}
    for case, of in rows.items():
        for key in ("error_mm", "sigma_mm", "nees"):
            values = [row[key] for row in of if row[key] is not None]
            found[f"{case}.{key}"] = float(np.mean(values)) if values else math.nan
        said = [row["said_s"] for row in of]
        found[f"{case}.said"] = Share(sum(each is not None for each in said), len(of))
        found[f"{case}.said_s"] = Quantile(said, 50.0)
        found[f"{case}.heard"] = Share(sum(row["silent"] <= 0.05 for row in of), len(of))
    return found


def figures() -> tuple[Figure, ...]:
    found = []
    for case, of in ROWS.items():
        nothing = case in ("ball", "fish", "cold", "warm", "map")
        found.append(Figure(f"{case}.error_mm", f"{of.words}: error", "mm"))
        found.append(Figure(f"{case}.sigma_mm", "it says", "mm"))
        exact = case in ("ball", "fish", "cold", "warm")  # a pose by tags says rather more, see tag-fix
        found.append(Figure(f"{case}.nees", "NEES", "", least=2.5 if exact else None, most=3.5 if exact else None))
        if nothing:
            found.append(Figure(f"{case}.said", "dives in which something is said", "%", most=5.0))
        else:
            found.append(Figure(f"{case}.said_s", "said after, half of the dives", "s"))
            found.append(Figure(f"{case}.heard", "dives not wrong in silence", "%", least=90.0 if of.shows else None))
    return tuple(found)


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(ROWS),
    quick={"seconds": 20.0},
    measured_on="model",
    figures=figures(),
    explanation="""The kernel's own targets agree over links that delay, on samples that are drawn, with the errors of
        the fleet's budget in them; whole agents swim by drawn tags. Nothing is rendered. Counted are the beliefs of a
        robot from ten seconds after the fault began, while its word is `consistent`. The robot is wrong in silence
        where their NEES is above 9 in the mean. A dive counts as not silent where such beliefs are at most one in
        twenty of all. A fish here swims more level than the kernel expects of one: its NEES is that of two coordinates.
        Rows without a target cannot be noticed: what all robots have wrong alike, or a whole map, is in no sample of
        theirs. What is not in the table was not tried.""",
)
