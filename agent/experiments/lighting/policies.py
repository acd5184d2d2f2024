"""Whose lamps burn while somebody sweeps: the rule, what it is compared with, and what lost messages make of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np

from agent.capabilities.light.allocate import Worth, allocate, worth
from agent.capabilities.light.model import Pair, pair
from agent.experiments.lighting.dark_water import DarkWater, Stand, lamps_of

Names = frozenset[str]

POLICIES = ("own", "all", "common", "rule", "optimum")


class Scored(NamedTuple):
    """What the model says of any set of lamps, for each robot of a fleet that sweeps."""

    pairs: dict[str, dict[str, Pair]]  # sweeper, then lamp
    of: Callable[[str, Names], Worth]


def scored(sea: DarkWater, stands: Mapping[str, Stand]) -> Scored:
    """Places and water exactly known."""
    pairs: dict[str, dict[str, Pair]] = {}
    for name, one in stands.items():
        scene = sea.scene_of(one)
        pairs[name] = {
            robot: pair(scene.camera_m, scene.target_m, scene.radius_m, lamp.place_m, sea.lighting)
            for robot, lamp in lamps_of(stands).items()
        }

    def of(name: str, burning: Names) -> Worth:
        scene = sea.scene_of(stands[name])
        chosen = [pairs[name][robot] for robot in sorted(burning)]
        return worth(chosen, stands[name].distance_m, scene.radius_m, scene.focal_px, scene.slope_mm)

    return Scored(pairs, of)


def all_sets(names: Mapping[str, Stand]) -> list[Names]:
    """Every set of lamps but the empty one."""
    return [frozenset(c) for k in range(1, len(names) + 1) for c in combinations(sorted(names), k)]


def sets_for(policy: str, sea: DarkWater, stands: Mapping[str, Stand], score: Scored) -> dict[str, Names]:
    """Whose lamps burn while each robot sweeps."""
    if policy == "own":
        return {name: frozenset((name,)) for name in stands}
    if policy == "all":
        return {name: frozenset(stands) for name in stands}
    if policy == "common":  # the one set that serves most robots, and among those best on the whole
        best = max(
            all_sets(stands),
            key=lambda burning: (
                sum(score.of(name, burning).usable for name in stands),
                sum(score.of(name, burning).log_j for name in stands),
            ),
        )
        return dict.fromkeys(stands, best)
    if policy == "optimum":
        return {name: max(all_sets(stands), key=lambda s, n=name: score.of(n, s).log_j) for name in stands}  # type: ignore[misc]
    lamps = lamps_of(stands)
    return {
        name: frozenset(allocate(name, sea.scene_of(one), lamps, sea.lighting).lamps) for name, one in stands.items()
    }


def after_loss(name: str, wanted: Names, loss: float, rng: np.random.Generator) -> Names:
    """The lamps that burn when messages get lost: a lender without its lease stays dark, and a sweeper that hears of
    none takes its own lamp, whoever burns beside it."""
    reached = {robot for robot in sorted(wanted - {name}) if rng.random() >= loss}
    answered = {robot for robot in sorted(reached) if rng.random() >= loss}
    own = {name} if name in wanted or (wanted != {name} and not answered) else set()
    return frozenset(reached | own)
