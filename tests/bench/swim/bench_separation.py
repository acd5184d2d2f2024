"""How near ten robots come that cross a tank of 3 x 2 m, each told by the others where they are.

Whole agents with tags in sight and odometry, tethers that pull and drags that are not as believed; bodies in the plane,
between walls. Each swims to one place after the other, through all others. In six pieces, each from a seed of its own,
side by side; an hour by AUCAMP_CROSSING_MIN=10, on seeds that nobody has looked at by AUCAMP_CROSSING_SEED.
Distances are between true centres, twenty times a second; the thruster rings of two robots touch at 0.34 m.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from typing import NamedTuple

import numpy as np

from agent.capabilities.swim.barrier import RINGS_M
from tests.capabilities.swim.swimming_fleet import FleetInTank, fleet_of
from tests.capabilities.swim.tank_with_tags import TANK_M

LOSSES = (0.0, 0.3)
FIRST_SEED = int(os.environ.get("AUCAMP_CROSSING_SEED", "101"))
SEEDS = tuple(range(FIRST_SEED, FIRST_SEED + 6))
MINUTES = float(os.environ.get("AUCAMP_CROSSING_MIN", "1"))  # of each piece
APART_M = 0.45  # between the goals of two, so that both can be reached
EDGE_M = 0.25  # of goals from the walls
THERE_M = 0.06
TRY_S = 25.0  # for one goal: others may stand in the way
SETTLE_S = 5.0  # until all know where they are


class Piece(NamedTuple):
    """What came of one seed."""

    least_m: float
    arrivals: int
    given_up: int


def run() -> dict[str, dict]:
    rows: dict[str, dict] = {}
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        pieces = dict(zip(product(LOSSES, SEEDS), pool.map(_piece, product(LOSSES, SEEDS)), strict=True))
    for loss in LOSSES:
        found = [pieces[loss, seed] for seed in SEEDS]
        minutes = MINUTES * len(SEEDS)
        arrived, all_of = sum(p.arrivals for p in found), sum(p.arrivals + p.given_up for p in found)
        rows[f"separation: ten robots, {minutes:.0f} min, loss {loss:.0%}"] = {
            "value": (least := min(p.least_m for p in found)),
            "unit": f"m, {arrived} of {all_of} goals reached",
            "against": f"rings touch at {RINGS_M} m",
            "ratio": least / RINGS_M,
        }
    return rows


def _piece(case: tuple[float, int]) -> Piece:
    return crossing(case[1], case[0], MINUTES)


def crossing(seed: int, loss: float, minutes: float, odometry: bool = True) -> Piece:
    """Ten robots that swim to and fro for that long."""
    xs, ys = (0.40, 0.95, 1.50, 2.05, 2.60), (0.5, 1.5)
    tank = FleetInTank(fleet_of([(x, y, 0.0) for y in ys for x in xs]), seed, loss, odometry)
    for one in tank.robots.values():
        one.agent.transaction.step = lambda state, work, inputs, now_ns: work(
            inputs, now_ns
        )  # no step breaks: a third quicker
    names, rng = list(tank.robots), np.random.default_rng((seed, 1))
    goals = dict(zip(names, tank.places, strict=True))
    since = dict.fromkeys(names, -TRY_S)
    least, arrivals, given_up = np.inf, 0, 0
    for step in range(round(minutes * 60 * 20)):
        tank.step()
        least = min(least, tank.least_m())
        now_s = step / 20.0 - SETTLE_S
        for name, place in zip(names, tank.places, strict=True):
            there = np.hypot(*(place - goals[name])) < THERE_M
            if now_s < 0.0 or not (there or now_s - since[name] > TRY_S):
                continue
            arrivals, given_up = arrivals + there, given_up + (not there)
            others = [goal for other, goal in goals.items() if other != name]
            goals[name], since[name] = free_place(rng, others), now_s
            tank.goto(name, goals[name])
    return Piece(float(least), arrivals, given_up)


def free_place(rng: np.random.Generator, taken: Sequence[np.ndarray]) -> np.ndarray:
    """A place in the tank that is nobody's goal."""
    while True:
        place = rng.uniform([EDGE_M] * 2, [TANK_M[0] - EDGE_M, TANK_M[1] - EDGE_M])
        if min(np.hypot(*(place - other)) for other in taken) > APART_M:
            return place
