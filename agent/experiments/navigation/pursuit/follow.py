"""Three robots that are told where a target is which wanders: how well they keep their distance, their sides of it, and
apart. How they follow by what they see themselves is an experiment of its own (agent/experiments/following)."""

from __future__ import annotations

import math

import numpy as np

from agent.core.config import Follow, Look, Pose
from agent.experiments.navigation import basin
from agent.experiments.navigation.bodies import twin_bodies
from agent.experiments.navigation.pursuit.wanderer import ToldEstimator, Wanderer
from agent.experiments.navigation.swimmers import Swimmers
from agent.experiments.result import Row
from agent.experiments.spread import rms
from hw.twin.scene import generator

ROBOTS, STANDOFF_M = 3, 0.7
SPEEDS_M_S = (0.1, 0.2)
FIND_S, SETTLE_S, WATCH_S = 12.0, 8.0, 30.0
EVEN_RAD = 2.0 * math.pi / ROBOTS


def follow(seed: int, watch_s: float = WATCH_S) -> Row:
    """The target swims at 0.1 m/s in one seed and 0.2 in the next.

    off_mm: rms of the distance less the standoff; gap_deg: rms of the angle between neighbours on the circle less an
    even one; nearest_m: of any robot to the target; least_m: of two robots.
    """
    rng, speed_m_s = generator(seed, "follow"), SPEEDS_M_S[seed % 2]
    names = [f"r{i + 1}" for i in range(ROBOTS)]
    what = Follow(target="ball", standoff_m=STANDOFF_M)
    first, robots = float(rng.uniform(-math.pi, math.pi)), {}
    for k, name in enumerate(names):  # all on one side, half a metre apart
        x, y = (0.6 + 0.55 * k, 0.45) if first > 0.0 else (2.4 - 0.55 * k, 1.55)
        others = tuple(other for other in names if other != name)
        pose = Pose(x_m=x, y_m=y, yaw_deg=90.0 if first > 0.0 else -90.0)
        robots[name] = basin.robot(name, pose, what, Look(tilt_deg=-10.0), others)
    fleet = basin.fleet(robots, seed)
    wanderer = Wanderer(rng, speed_m_s, FIND_S + SETTLE_S + watch_s)
    with twin_bodies(fleet) as bodies:
        swimmers = Swimmers(fleet, bodies, wanderer.at)
        for agent in swimmers.agents.values():
            agent.targets["ball"].estimator = ToldEstimator(wanderer, lambda: bodies.now_ns, seed)
        for _ in range(round((FIND_S + SETTLE_S) * 20.0)):
            swimmers.step()
        rows = []
        for _ in range(round(watch_s * 20.0)):
            swimmers.step()
            x, y, _ = wanderer.at(bodies.now_ns)
            rows.append([(px - x, py - y) for px, py, _ in map(swimmers.place, names)])
    return {**figures(np.array(rows)), "speed_m_s": speed_m_s}


def figures(arms: np.ndarray) -> Row:
    """arms: from the target to each robot, m, (steps, robots, 2)."""
    distance = np.linalg.norm(arms, axis=2)
    ways = np.sort(np.arctan2(arms[..., 1], arms[..., 0]), axis=1)
    gaps = np.diff(np.concatenate([ways, ways[:, :1] + 2.0 * math.pi], axis=1), axis=1)
    apart = np.linalg.norm(arms[:, :, None] - arms[:, None], axis=3)[:, *np.triu_indices(arms.shape[1], 1)]
    return {
        "off_mm": 1e3 * rms((distance - STANDOFF_M).ravel()),
        "gap_deg": math.degrees(rms((gaps - EVEN_RAD).ravel())),
        "nearest_m": float(distance.min()),
        "least_m": float(apart.min()),
    }
