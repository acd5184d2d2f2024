"""Robots that nobody has told where the ball lies look for it: three who divide the basin, or one alone.

The ball lies where none of the three sees it from where it starts, looking ahead.
"""

from __future__ import annotations

import math

import numpy as np

from agent.core.config import Look, Pose, Search
from agent.core.linear_algebra import wrap
from agent.core.messages import Vector
from agent.experiments.navigation import basin
from agent.experiments.navigation.basin import TANK
from agent.experiments.navigation.bodies import PlanarBodies
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.result import Row
from hw.twin.scene import generator

SEARCH_ROBOTS, SEARCH_FIND_S, SEARCH_S = 3, 12.0, 180.0
APART_M, CLEAR_M, BALL_M = 0.6, 0.35, 0.25  # of starts from each other and from walls; of the ball from walls
BLIND_DEG, FAR_M = 40.0, 1.7  # a start sees within so much of straight ahead, and so far


def search(seed: int, robots: int = SEARCH_ROBOTS, search_s: float = SEARCH_S) -> Row:
    """s: from when the first robot swims until any has measured the ball, None if that does not happen; least_m:
    between any two; told: share of robots that know it 5 s later."""
    poses, ball_m = starts(seed)
    names = [f"r{i + 1}" for i in range(robots)]
    what = Search(target="ball")
    fleet = basin.fleet(
        {
            name: basin.robot(name, pose, what, Look(tilt_deg=-10.0), tuple(other for other in names if other != name))
            for name, pose in zip(names, poses, strict=False)
        },
        seed,
    )
    bodies = PlanarBodies(fleet)
    swimmers = Swimmers(fleet, bodies, ball_m)
    for _ in range(round(SEARCH_FIND_S * 20.0)):
        swimmers.step()
        if any(swimmers.swims(name) for name in names):
            break
    began_ns, found_ns, least_m, path = bodies.now_ns, None, math.inf, []
    while bodies.now_ns - began_ns < search_s * 1e9:
        swimmers.step()
        here = np.array([swimmers.place(name)[:2] for name in names])
        path.append(here)
        apart = np.linalg.norm(here[:, None] - here[None], axis=2)[np.triu_indices(robots, 1)]
        least_m = min([least_m, *apart.tolist()])
        knows = [agent.current.estimator.posterior is not None for agent in swimmers.agents.values()]
        if found_ns is None and any(knows):
            found_ns = bodies.now_ns
        if found_ns is not None and bodies.now_ns - found_ns >= 5e9:
            break
    seconds = None if found_ns is None else (found_ns - began_ns) * 1e-9
    return {"s": seconds, "least_m": least_m, "told": float(np.mean(knows)), "path": np.array(path), "ball_m": ball_m}


def starts(seed: int) -> tuple[list[Pose], Vector]:
    """Poses of three, and a place of the ball that none sees ahead of it."""
    rng = generator(seed, "search")
    low, high = np.full(2, CLEAR_M), np.array(TANK.size_m[:2]) - CLEAR_M
    while True:
        places = rng.uniform(low, high, (SEARCH_ROBOTS, 2))
        yaws = rng.uniform(-math.pi, math.pi, SEARCH_ROBOTS)
        ball = rng.uniform(BALL_M, np.array(TANK.size_m[:2]) - BALL_M)
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)[np.triu_indices(SEARCH_ROBOTS, 1)]
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
