"""The fleet of a draw, where it begins, and the weeds that hide its target."""

from __future__ import annotations

import math

import msgspec
import numpy as np

from agent.core.config import Fleet, Follow, Limits, Look, Navigation, Pose, Target
from agent.experiments.following.cases import LENGTH_M, Case
from agent.experiments.navigation import basin
from agent.experiments.navigation.drawn_ball import Pillar
from hw.twin.scene import generator

STANDOFF_M = 0.7
STILL = Limits(speed_m_s=0.001, turn_deg_s=0.1)  # of what is moored
WEEDS, WEED_M, WALL_M, APART_M = 2, 0.08, 0.5, 0.8  # how many, their radius; from walls, and from each other
ROW_M = 0.45, 1.55  # from the long wall at which all begin


def fleet_of(case: Case, seed: int) -> Fleet:
    """All of them know how fast the target swims, and how long it is."""
    names = [f"r{i + 1}" for i in range(case.robots)]
    robots = {
        name: basin.robot(
            name,
            pose,
            Follow(target="ball", standoff_m=STANDOFF_M, search=True),
            Look(tilt_deg=-10.0),
            tuple(other for other in names if other != name),
        )
        for name, pose in zip(names, starts(case, seed), strict=True)
    }
    fish = Target(detector="creature", length_m=LENGTH_M, speed_m_s=case.speed_m_s, turn_s=basin.TURN_S)
    fleet = basin.fleet(robots, seed, fish)
    return msgspec.structs.replace(fleet, navigation=Navigation(limits=STILL)) if case.policy == "moored" else fleet


def starts(case: Case, seed: int) -> list[Pose]:
    """All on one side, half a metre apart; what is moored looks inwards from all around."""
    if case.policy == "moored":
        return [
            Pose(x_m=0.45, y_m=0.45, yaw_deg=35.0),
            Pose(x_m=2.55, y_m=0.45, yaw_deg=145.0),
            Pose(x_m=1.5, y_m=1.55, yaw_deg=-90.0),
        ][: case.robots]
    near = float(generator(seed, "follow").uniform(-math.pi, math.pi)) > 0.0
    pitch_m = 0.55 if case.robots <= 3 else 0.45
    return [
        Pose(x_m=0.6 + k * pitch_m if near else 2.4 - k * pitch_m, y_m=ROW_M[0] if near else ROW_M[1], yaw_deg=yaw)
        for k, yaw in enumerate([90.0 if near else -90.0] * case.robots)
    ]


def weeds(seed: int) -> tuple[Pillar, ...]:
    """Upright from floor to surface. What is behind one is hidden; they hold nobody up."""
    rng, found = generator(seed, "weeds"), list[Pillar]()
    length_m, breadth_m, _ = basin.TANK.size_m
    while len(found) < WEEDS:
        x, y = rng.uniform((WALL_M, WALL_M), (length_m - WALL_M, breadth_m - WALL_M)).tolist()
        if all(np.hypot(x - other.x_m, y - other.y_m) > APART_M for other in found):
            found.append(Pillar(x, y, WEED_M))
    return tuple(found)
