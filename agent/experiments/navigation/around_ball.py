"""Robots around a ball, robots whose ways cross, and robots that rarely see tags and are aided by a ball.

`target`: three robots hold their places around a ball and say where it is. The bound is the error of `JointFilter`,
which has every measurement of all of them. `crossing`: how near robots come to each other. `aided`: how much a ball
that others have located tells a robot of where it is itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import msgspec
import numpy as np
from msgspec.structs import replace

from agent.capabilities.swim.barrier import RINGS_M
from agent.capabilities.swim.localizer import LOST_DEG, LOST_M, within
from agent.capabilities.swim.pose_filter import Belief
from agent.capabilities.swim.swim import swimmer_of
from agent.capabilities.swim.swimmer import Swimmer
from agent.core.config import Fleet, Goto, Look, Navigation, Pose
from agent.core.linear_algebra import plus, wrap
from agent.core.messages import Vector
from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value, rms
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK, PlanarBodies, twin_bodies
from agent.experiments.navigation.joint_filter import Array, Replayed, full
from agent.experiments.navigation.swimmers import Swimmers
from hw.twin.scene import generator

AROUND_M = 0.75
BALL_M = (0.5 * TANK.size_m[0], 0.5 * TANK.size_m[1], 0.07)
BALL_LOOK = Look(tilt_deg=-20.0)


def around(ways: Sequence[float], seed: int) -> Fleet:
    """Robots that hold their places in those directions from the ball, rad, and face it."""
    poses = [
        Pose(
            x_m=BALL_M[0] + AROUND_M * math.cos(way),
            y_m=BALL_M[1] + AROUND_M * math.sin(way),
            yaw_deg=math.degrees(wrap(way + math.pi)),
        )
        for way in ways
    ]
    return basin.linked(poses, seed, BALL_LOOK)


# --- target: where the ball is ---

ROBOTS, TARGET_S = 3, 60.0


def target(seed: int, seconds: float = TARGET_S) -> Row:
    """Errors of the robots and of the bound at the end, and both normalised errors squared, a third."""
    rng = generator(seed, "ball")
    first = float(rng.uniform(-math.pi, math.pi))
    fleet = around([first + 2.0 * math.pi * k / ROBOTS + float(rng.uniform(-0.2, 0.2)) for k in range(ROBOTS)], seed)
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies, BALL_M)
        replayed = Replayed(swimmers)
        for _ in swimmers.each_step(seconds):
            pass
        own = [agent.measuring.current.estimator.posterior for agent in swimmers.agents.values()]
    at, covariance = replayed.joint().target
    errors = [(np.array(known.x_m) - BALL_M, full(known.cov_m2)) for known in own if known is not None]
    return {
        "silent": ROBOTS - len(errors),  # robots that do not know where it is
        "error_mm": [1e3 * float(np.linalg.norm(e)) for e, _ in errors],
        "nees": [_nees(e, says) for e, says in errors],
        "bound_mm": 1e3 * float(np.linalg.norm(at - BALL_M)),
        "bound_nees": _nees(at - BALL_M, covariance),
        "samples": replayed.samples,
    }


def _nees(e: Array, covariance: Array) -> float:
    """A third of the normalised error squared: 1 where it is honest."""
    return float(e @ np.linalg.solve(covariance, e)) / 3.0


# --- crossing: how near robots come to each other, while all of them swim to and fro ---
# Distances are centre to centre and by the truth. The crew arms them when all have found themselves: no robot keeps
# clear of one that cannot say where it is. They begin facing the middle, for a wall near by shows no whole tag.

CROSSING_ROBOTS, CROSSING_S, LOSS = 10, 30.0, 0.3
FIND_S = 30.0  # in the hands of the crew, at most
APART_M = 0.45  # goals of two; the fleet file demands 0.36
CLEAR_M = 0.22  # of goals, from walls
THERE_M, TRY_S = 0.06, 25.0  # a robot gets a new goal when it is there, or has tried for so long


def crossing(seed: int, robots: int = CROSSING_ROBOTS, seconds: float = CROSSING_S, loss: float = 0.0) -> Row:
    """Least distance (m) of any two, and how many goals were tried and reached; loss: share of words that is lost."""
    rng, chance = generator(seed, "crossing"), generator(seed, "loss")
    places: list[Vector] = []
    for _ in range(robots):
        places.append(free_place(rng, places))
    fleet = basin.linked([_facing_middle(x, y) for x, y, _ in places], seed)
    bodies = PlanarBodies(fleet)
    swimmers = Swimmers(fleet, bodies)
    swimmers.lost = lambda letter: bool(chance.random() < loss)
    bodies.armed = False
    for _ in swimmers.each_step(FIND_S):
        if not any(one.lost for one in _swimmers_of(swimmers)):
            break
    bodies.armed = True
    goals, since_s = dict(zip(fleet.robot, places, strict=True)), dict.fromkeys(fleet.robot, -TRY_S)
    least_m, tried, reached = math.inf, 0, 0
    for now_s in swimmers.each_step(seconds):
        least_m = min(least_m, swimmers.least_apart_m())
        for name, one in zip(goals, _swimmers_of(swimmers), strict=True):
            there = math.dist(swimmers.place(name)[:2], goals[name][:2]) < THERE_M
            if not there and now_s - since_s[name] < TRY_S:
                continue
            if since_s[name] >= 0.0:  # else it is where it begins
                tried, reached = tried + 1, reached + there
            goals[name] = free_place(rng, [goal for other, goal in goals.items() if other != name])
            since_s[name] = now_s
            one.active.begin(Goto(x_m=goals[name][0], y_m=goals[name][1]))
    return {"least_m": least_m, "tried": tried, "reached": reached}


def free_place(rng: np.random.Generator, taken: Sequence[Vector]) -> Vector:
    """A place in the basin, APART_M and more from those. Ten robots leave room for it wherever their goals are."""
    while True:
        x, y = (float(rng.uniform(CLEAR_M, side_m - CLEAR_M)) for side_m in TANK.size_m[:2])
        if all(math.dist((x, y), other[:2]) >= APART_M for other in taken):
            return x, y, 0.0


def _facing_middle(x_m: float, y_m: float) -> Pose:
    return Pose(x_m=x_m, y_m=y_m, yaw_deg=math.degrees(math.atan2(BALL_M[1] - y_m, BALL_M[0] - x_m)))


def _swimmers_of(swimmers: Swimmers) -> list[Swimmer]:
    found = [swimmer_of(agent.capabilities) for agent in swimmers.agents.values()]
    return [one for one in found if one is not None]


# --- aided: robots that rarely see tags, around a ball that others have located ---
# Nothing else tells a robot how it moves: no points to follow, and a gyro in one case only. A robot that sees tags more
# rarely than these looks for them all the time, and no more at the ball.

S = 1_000_000_000
AID_FIND_S, AID_S = 15.0, 40.0  # with tags until then; then rarely
SHOWS_S, EVERY_S = 2, (2, 4, 6, 8)  # tags in 2 s of every so many; of each robot, the first always sees them


def aided(seed: int, gyro: bool = False, seconds: float = AID_S) -> Row:
    """Errors of each robot's own and aided pose while it knows where it is, after a quarter of the time; how often it
    is aided, and the sum of its normalised errors squared then, a third of each."""
    first = float(generator(seed, "aid").uniform(-math.pi, math.pi))
    fleet = around([first + 2.0 * math.pi * k / len(EVERY_S) for k in range(len(EVERY_S))], seed)
    fleet = replace(fleet, navigation=Navigation(gyro=gyro))
    own_m: dict[str, list[float]] = {name: [] for name in fleet.robot}
    aided_m: dict[str, list[float]] = {name: [] for name in fleet.robot}
    nees: list[float] = []
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies, BALL_M)
        swimmers.follows_points = False
        for _ in swimmers.each_step(AID_FIND_S):
            pass
        for eyes, every_s in zip(swimmers.eyes.values(), EVERY_S, strict=True):
            eyes.sees_tags = partial(_shows_tags, every_s)
        for now_s in swimmers.each_step(seconds):
            if now_s <= 0.25 * seconds:
                continue
            for name, one in zip(fleet.robot, _swimmers_of(swimmers), strict=True):
                own, best, truth = one.localizer.at(swimmers.now_ns), one.here, swimmers.place(name)
                if own is None or best is None or not within(own, LOST_M, LOST_DEG):
                    continue
                own_m[name].append(math.dist(own.pose[:2], truth[:2]))
                aided_m[name].append(math.dist(best.pose[:2], truth[:2]))
                if best.pose != own.pose:
                    nees.append(_planar_nees(best, np.array(truth)))
    return {
        "own_mm": [_rms_mm(found) for found in own_m.values()],
        "aided_mm": [_rms_mm(found) for found in aided_m.values()],
        "aided": len(nees),
        "nees": sum(nees),
    }


def _shows_tags(every_s: int, now_ns: int) -> bool:
    return now_ns % (every_s * S) < SHOWS_S * S


def _planar_nees(belief: Belief, truth: Array) -> float:
    e = np.array(belief.pose) - truth
    e[2] = wrap(float(e[2]))
    return _nees(e, full(plus(belief.covariance, belief.stays)))


def _rms_mm(off_m: list[float]) -> float | None:
    found = rms(off_m)
    return None if found is None else 1e3 * found


# --- the claim ---


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    target_s: float = TARGET_S
    robots: int = CROSSING_ROBOTS  # that cross
    crossing_s: float = CROSSING_S
    loss: float = LOSS  # share of words that is lost, where some are
    aid_s: float = AID_S


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises Failed where a firmware hangs."""
    if case == "target":
        return [target(seed, settings.target_s)]
    if case in ("aid", "aid-gyro"):
        return [aided(seed, case == "aid-gyro", settings.aid_s)]
    return [crossing(seed, settings.robots, settings.crossing_s, settings.loss if case == "separation-loss" else 0.0)]


def summary(rows: Rows) -> dict[str, Value]:
    """Root mean squares are over seeds and robots. Where one robot does not know the ball, there is no number. Aided:
    the robots whose tags are rare, all together."""
    found: dict[str, Value] = {}
    for case in {"separation", "separation-loss"} & set(rows):
        of = rows[case]
        found[f"{case}_least_m"] = min(row["least_m"] for row in of)
        found[f"{case}_keep"] = Share(sum(row["least_m"] >= RINGS_M for row in of), len(of))
        found[f"{case}_reached"] = Share(sum(row["reached"] for row in of), sum(row["tried"] for row in of))
    if "target" in rows:
        errors_mm, nees = ([value for row in rows["target"] for value in row[key]] for key in ("error_mm", "nees"))
        error_mm, bound_mm = rms(errors_mm), rms([row["bound_mm"] for row in rows["target"]])
        if error_mm is None or any(row["silent"] for row in rows["target"]):
            error_mm, nees = None, []
        found["target_mm"], found["target_bound_mm"] = error_mm, bound_mm
        found["target_ratio_to_bound"] = error_mm / bound_mm if error_mm and bound_mm else None
        found["target_nees"] = float(np.mean(nees)) if nees else None
    for case in {"aid", "aid-gyro"} & set(rows):
        for key in ("own_mm", "aided_mm"):
            found[f"{case}_{key}"] = rms([off for row in rows[case] for off in row[key][1:] if off is not None])
        moments = sum(row["aided"] for row in rows[case])
        found[f"{case}_nees"] = sum(row["nees"] for row in rows[case]) / moments if moments else None
    return found


def _crossing_figures(case: str, words: str) -> tuple[Figure, ...]:
    return (
        Figure(f"{case}_keep", f"{words}: no two nearer than 0.34 m, share of dives", "%", least=95.0),
        Figure(f"{case}_least_m", "their least distance in all dives", "m"),
        Figure(f"{case}_reached", "goals that they reach within 25 s", "%"),
    )


def _aid_figures(case: str, words: str) -> tuple[Figure, ...]:
    return (
        Figure(f"{case}_own_mm", f"{words}: own pose, rms", "mm"),
        Figure(f"{case}_aided_mm", "the same, aided by the ball", "mm"),
        Figure(f"{case}_nees", "the aided pose's error as it says: NEES/3", "", most=1.3),
    )


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=("separation", "separation-loss", "target", "aid", "aid-gyro"),
    quick={"target_s": 15.0, "robots": 4, "crossing_s": 10.0, "aid_s": 12.0},
    measured_on="twin",
    figures=(
        *_crossing_figures("separation", "ten robots swim to and fro for 30 s"),
        *_crossing_figures("separation-loss", "the same, 30 % of words lost"),
        Figure("target_mm", "the ball's place, three robots around it: off, rms", "mm"),
        Figure("target_bound_mm", "the same of one filter that has all measurements", "mm"),
        Figure("target_ratio_to_bound", "the former to the latter", "", most=1.2),
        Figure("target_nees", "their error as they say: NEES/3", "", least=0.7, most=1.3),
        *_aid_figures("aid", "robots that see tags 2 s of every 4, 6 and 8 s"),
        *_aid_figures("aid-gyro", "the same, each with a gyro"),
    ),
    seeds=60,  # as many as the shares take
    explanation="""Whole agents swim with drawn tags and a drawn ball: on the twin's bodies under the board's firmware,
        and on planar bodies where ten of them cross, each told by the others where they are. The thruster rings of two
        robots touch at 0.34 m. The bound is a filter that has every measurement of all robots and keeps every
        correlation. NEES is the error squared in units of the stated covariance, 3 where it is honest; poses count
        while a robot knows by itself where it is.""",
)
