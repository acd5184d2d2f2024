"""How soon robots find a ball that lies where none of them sees it at first: three that divide the basin, or one."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from agent.capabilities.swim.barrier import RINGS_M
from agent.core.config import Look, Pose, Search
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.experiments.claim import Claim, Figure, Quantile, Row, Rows, Share, Value
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK, PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers
from hw.twin.scene import generator

ROBOTS, AHEAD = 3, Look(tilt_deg=-10.0)
FIND_S, SEARCH_S = 12.0, 180.0
TELLS_S = 5.0  # after the first has measured the ball: until all have heard of it
APART_M, CLEAR_M, BALL_M = 0.6, 0.35, 0.25  # of starts from each other and from walls; of the ball from walls
BLIND_DEG, FAR_M = 40.0, 1.7  # a start sees within so much of straight ahead, and so far


def search(seed: int, robots: int = ROBOTS, search_s: float = SEARCH_S) -> Row:
    """s: from when the first robot swims until any has measured the ball, None if that does not happen; least_m:
    between any two, None of one; told: how many know it 5 s later."""
    poses, ball_m = starts(seed)
    fleet = basin.linked(poses[:robots], seed, AHEAD, [Search(target="ball")] * robots)
    swimmers = Swimmers(fleet, PlanarBodies(fleet), ball_m)
    for _ in swimmers.each_step(FIND_S):
        if any(map(swimmers.swims, fleet.robot)):
            break
    found_s, least_m, told = None, math.inf, 0
    for now_s in swimmers.each_step(search_s + TELLS_S):
        least_m = min(least_m, swimmers.least_apart_m())
        told = sum(a.measuring.current.estimator.posterior is not None for a in swimmers.agents.values())
        if found_s is None and told:
            found_s = now_s
        if now_s >= (search_s if found_s is None else found_s + TELLS_S):
            break
    return {"s": found_s, "least_m": least_m if robots > 1 else None, "told": told, "robots": robots}


def starts(seed: int) -> tuple[list[Pose], Vector]:
    """Poses of three, and a place of the ball that none sees ahead of it."""
    rng = generator(seed, "search")
    low, high = np.full(2, CLEAR_M), np.array(TANK.size_m[:2]) - CLEAR_M
    while True:
        places = rng.uniform(low, high, (ROBOTS, 2))
        yaws = rng.uniform(-math.pi, math.pi, ROBOTS)
        ball = rng.uniform(BALL_M, np.array(TANK.size_m[:2]) - BALL_M)
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(ROBOTS, 1)]
        way = ball - places
        off = [abs(wrap(math.atan2(y, x) - yaw)) for (x, y), yaw in zip(way.tolist(), yaws.tolist(), strict=True)]
        hidden = (np.array(off) > math.radians(BLIND_DEG)) | (np.linalg.norm(way, axis=1) > FAR_M)
        if apart.min() > APART_M and hidden.all() and np.linalg.norm(way, axis=1).min() > APART_M:
            break
    poses = [
        Pose(x_m=float(x), y_m=float(y), yaw_deg=math.degrees(yaw))
        for (x, y), yaw in zip(places, yaws.tolist(), strict=True)
    ]
    return poses, (float(ball[0]), float(ball[1]), 0.07)


# --- the claim ---


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    search_s: float = SEARCH_S  # at most


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    return [search(seed, ROBOTS if case == "three" else 1, settings.search_s)]


def summary(rows: Rows) -> dict[str, Value]:
    found: dict[str, Value] = {f"{case}_s": Quantile([row["s"] for row in of], 95.0) for case, of in rows.items()}
    if "three" in rows:
        of, least_m = rows["three"], [row["least_m"] for row in rows["three"]]
        # Robots of one dive are no trials of their own: a number, whose interval is that of dives.
        found["three_told"] = 100.0 * sum(row["told"] for row in of) / sum(row["robots"] for row in of)
        found["three_least_m"] = Quantile(least_m, 0.0)
        found["three_keep"] = Share(sum(apart_m >= RINGS_M for apart_m in least_m), len(least_m))
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=("three", "alone"),
    quick={"search_s": 20.0},
    measured_on="twin",
    figures=(
        Figure("three_s", "three search a ball: until one has measured it, 95 % of seeds", "s"),
        Figure("three_told", "share of robots that know it 5 s later", "%"),
        Figure("three_keep", "no two nearer than 0.34 m, share of dives", "%", least=95.0),
        Figure("three_least_m", "their least distance in all dives", "m"),
        Figure("alone_s", "one searches alone: until it has measured it, 95 %", "s"),
    ),
    seeds=60,  # as many as the shares take
    explanation="""The ball lies where none of three robots sees it from where it starts, looking ahead. The robots are
        planar, and frames are drawn. The thruster rings of two robots touch at 0.34 m.""",
)
