"""A robot that is knocked, wrong for a while without knowing it, then repaired and started again: is it believed?"""

from __future__ import annotations

import math
from random import Random

import numpy as np

from agent.core.estimation.interface import Update
from agent.experiments.localization.draws import WORLD
from agent.experiments.localization.liar import AFTER, FIRST, LAST, Outcome, apart_m, fleet_of, outcome
from agent.experiments.localization.liar_cases import LiarCase
from agent.experiments.localization.lockstep import prior, symmetric
from agent.experiments.localization.world import draw_dive, draw_world


def bumped(case: LiarCase, seed: int, number: int) -> Outcome:
    """One draw, beside the same fleet in which nobody was knocked.

    `share` is the weight of robot 0 in what the others conclude at the end, over its weight in that other fleet.
    """
    world = draw_world(case.robots, "aniso", True, np.random.default_rng(WORLD))
    rng, iterations = np.random.default_rng((seed, number)), LAST + AFTER
    dive = draw_dive(world, "all", 0.0, iterations, rng)
    angle = rng.uniform(0.0, 2.0 * math.pi)
    knock_m = case.bumped_mm * 1e-3 * np.array([math.cos(angle), math.sin(angle), 0.0])
    sound, knocked = (fleet_of(case, Random(f"{seed} {number}")) for _ in range(2))
    own, fixed = symmetric(world.random_m2), symmetric(world.systematic_m2)
    moved, shares = [], (0.0, 0.0)
    for k in range(iterations):
        if k == LAST:
            knocked.restart(0)
        priors = [prior(dive.sample_m[k, i], own[i], fixed[i], sound.now_ns) for i in range(case.robots)]
        wrong = prior(dive.sample_m[k, 0] + knock_m * (k < LAST), own[0], fixed[0], sound.now_ns)
        shares = share(sound.tick(priors)), share(knocked.tick([wrong, *priors[1:]]))
        sound.speak()
        knocked.speak()
        moved.append(apart_m(sound, knocked, range(1, case.robots)))
    return outcome(moved, [None] * (LAST - FIRST))._replace(share=shares[1] / shares[0])


def share(updates: list[Update]) -> float:
    """Weight of robot 0 in the conclusions of the others, the mean."""
    weights = [update.explain.weights.get("r0", 0.0) for update in updates[1:]]
    return math.fsum(weights) / len(weights)
