"""Robots whose ways cross, and robots around a ball."""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec
import numpy as np

from agent.capabilities.swim.barrier import RINGS_M
from agent.core.config import Fleet, Goto, Look, Pose
from agent.core.linear_algebra import difference, distance2, upper, wrap
from agent.core.messages import Vector
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value, rms
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK, PlanarBodies, twin_bodies
from agent.experiments.navigation.joint_filter import Replayed
from agent.experiments.navigation.swimmers import Swimmers, frame_error_m
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
        told = [agent.measuring.current.consistency.verdict(swimmers.now_ns) for agent in swimmers.agents.values()]
    at, covariance = replayed.joint().target
    errors = [(difference(known.x_m, BALL_M), known.cov_m2) for known in own if known is not None]
    off_m = frame_error_m(fleet)
    off = difference(at.tolist(), BALL_M)
    return {
        "silent": ROBOTS - len(errors),  # robots that do not know where it is
        "doubted": any(word != "consistent" for word, _ in told),
        "error_mm": [1e3 * math.hypot(*e) for e, _ in errors],
        "nees": [distance2(says, difference(e, off_m)) / 3.0 for e, says in errors],
        "bound_mm": 1e3 * math.hypot(*off),
        "bound_nees": distance2(upper(covariance), off) / 3.0,
        "samples": replayed.samples,
    }


# --- crossing: how near robots come to each other, while all of them swim to and fro ---
# Distances are centre to centre and by the truth. The crew arms them when all have found themselves: no robot keeps
# clear of one that cannot say where it is. They begin facing the middle, for a wall near by shows no whole tag.

CROSSING_ROBOTS, CROSSING_S, LOSS = 10, 30.0, 0.3
FIND_S = 30.0  # in the hands of the crew, at most
APART_M = 0.45  # goals of two; the fleet file demands 0.36
CLEAR_M = 0.22  # of goals, from walls
THERE_M, TRY_S = 0.06, 25.0  # a robot gets a new goal when it is there, or has tried for so long


def crossing(seed: int, robots: int = CROSSING_ROBOTS, seconds: float = CROSSING_S, loss: float = LOSS) -> Row:
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
        if not any(swimmers.swimmer(name).lost for name in fleet.robot):
            break
    bodies.armed = True
    goals, since_s = dict(zip(fleet.robot, places, strict=True)), dict.fromkeys(fleet.robot, -TRY_S)
    least_m, tried, reached = math.inf, 0, 0
    for now_s in swimmers.each_step(seconds):
        least_m = min(least_m, swimmers.least_apart_m())
        for name in goals:
            there = math.dist(swimmers.place(name)[:2], goals[name][:2]) < THERE_M
            if not there and now_s - since_s[name] < TRY_S:
                continue
            if since_s[name] >= 0.0:  # else it is where it begins
                tried, reached = tried + 1, reached + there
            goals[name] = free_place(rng, [goal for other, goal in goals.items() if other != name])
            since_s[name] = now_s
            swimmers.swimmer(name).active.begin(Goto(x_m=goals[name][0], y_m=goals[name][1]))
    return {"least_m": least_m, "tried": tried, "reached": reached}


def free_place(rng: np.random.Generator, taken: Sequence[Vector]) -> Vector:
    """A place in the basin, APART_M and more from those. Ten robots leave room for it wherever their goals are."""
    while True:
        x, y = (float(rng.uniform(CLEAR_M, side_m - CLEAR_M)) for side_m in TANK.size_m[:2])
        if all(math.dist((x, y), other[:2]) >= APART_M for other in taken):
            return x, y, 0.0


def _facing_middle(x_m: float, y_m: float) -> Pose:
    return Pose(x_m=x_m, y_m=y_m, yaw_deg=math.degrees(math.atan2(BALL_M[1] - y_m, BALL_M[0] - x_m)))


# --- the claim ---


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    target_s: float = TARGET_S
    robots: int = CROSSING_ROBOTS  # that cross
    crossing_s: float = CROSSING_S
    loss: float = LOSS  # share of words that is lost


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises Failed where a firmware hangs."""
    if case == "target":
        return [target(seed, settings.target_s)]
    return [crossing(seed, settings.robots, settings.crossing_s, settings.loss)]


def summary(rows: Rows) -> dict[str, Value]:
    """Root mean squares are over seeds and robots. Where one robot does not know the ball, there is no number."""
    found: dict[str, Value] = {}
    if "separation" in rows:
        of = rows["separation"]
        found["separation_least_m"] = Quantile([row["least_m"] for row in of], 0.0)
        found["separation_keep"] = Share(sum(row["least_m"] >= RINGS_M for row in of), len(of))
        tried = sum(row["tried"] for row in of)  # the goals of one dive are no trials of their own
        found["separation_reached"] = 100.0 * sum(row["reached"] for row in of) / tried if tried else math.nan
    if "target" in rows:
        errors_mm, nees = ([value for row in rows["target"] for value in row[key]] for key in ("error_mm", "nees"))
        error_mm, bound_mm = rms(errors_mm), rms([row["bound_mm"] for row in rows["target"]])
        if error_mm is None or any(row["silent"] for row in rows["target"]):
            error_mm, nees = None, []
        found["target_mm"], found["target_bound_mm"] = error_mm, bound_mm
        found["target_ratio_to_bound"] = error_mm / bound_mm if error_mm and bound_mm else None
        found["target_doubted"] = Share(sum(row["doubted"] for row in rows["target"]), len(rows["target"]))
        found["target_nees"] = float(np.mean(nees)) if nees else None
    return found


CROSS = "ten robots swim to and fro for 30 s, 30 % of words lost"
CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=("separation", "target"),
    quick={"target_s": 15.0, "robots": 4, "crossing_s": 10.0},
    measured_on="twin",
    figures=(
        Figure("separation_keep", f"{CROSS}: no two nearer than 0.34 m, share of dives", "%", least=95.0),
        Figure("separation_least_m", "their least distance in all dives", "m"),
        Figure("separation_reached", "goals that they reach within 25 s", "%"),
        Figure("target_mm", "the ball's place, three robots around it: off, rms", "mm"),
        Figure("target_bound_mm", "the same of one filter that has all measurements", "mm"),
        Figure("target_ratio_to_bound", "the former to the latter", "", most=1.2),
        Figure("target_nees", "their error as they say: NEES/3", "", least=0.7, most=1.3),
        Figure("target_doubted", "dives at whose end a robot says another word than `consistent`", "%"),
    ),
    seeds=60,  # as many as the shares take
    explanation="""Whole agents swim with drawn tags and a drawn ball: on the twin's bodies under the board's firmware,
        and on planar bodies where ten of them cross, each told by the others where they are. The thruster rings of two
        robots touch at 0.34 m. The bound is a filter that has every measurement of all robots and keeps every
        correlation. NEES is the error squared in units of the stated covariance, 3 where it is honest.""",
)
