"""Three robots after a fish in the dark: who sees it by the light that they agree on, and by each one's own lamp.

Own lamps burn always, each beside its camera: these are all lamps at once. Seeds by AUCAMP_CHASE_SEEDS, policies by
AUCAMP_CHASE_POLICIES, length by AUCAMP_CHASE_S. The first ten seconds, in which robots find themselves and the fish,
do not count. On a busy machine figures differ a little, as those of bench_night.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any

import numpy as np

from tests.bench.light.chase import Row, chase, fish_in_the_dark
from tests.bench.light.lockstep import calibrated

SEEDS = [int(seed) for seed in os.environ.get("AUCAMP_CHASE_SEEDS", "3").split()]
POLICIES = os.environ.get("AUCAMP_CHASE_POLICIES", "rule own").split()
DIVE_S = float(os.environ.get("AUCAMP_CHASE_S", "40"))
FIND_S = 10.0
AGREED = {"rule": True, "own": False}


def run() -> dict[str, dict[str, Any]]:
    rows = {}
    for seed in SEEDS:
        fleets = {policy: fish_in_the_dark(seed, AGREED[policy]) for policy in POLICIES}
        any_of = fleets[POLICIES[0]]
        calibrations = {robot: calibrated(any_of, robot) for robot in any_of.robot}  # the same robots by all policies
        rows |= {
            f"chase by {policy} light, seed {seed}": figures(chase(fleet, calibrations, DIVE_S))
            for policy, fleet in fleets.items()
        }
    return rows


def figures(rows: Sequence[Row]) -> dict[str, Any]:
    counted = [row for row in rows if row.t_s > FIND_S]
    sees, off_m = np.array([row.sees for row in counted]), np.array([row.off_m for row in counted])
    burns, glances = (np.array([getattr(row, key) for row in counted]) for key in ("burns", "glances"))
    at_once = sees.sum(axis=1)
    known_mm = 1e3 * off_m[np.isfinite(off_m)]
    track = "nobody knows where it is"
    if known_mm.size:
        track = f"tracks {np.sqrt(np.mean(known_mm**2)):.0f} mm rms, median {np.median(known_mm):.0f} mm"
    return {
        "value": 100.0 * float(np.mean(sees)),
        "unit": "% of the time that each robot sees the fish",
        "against": f"one of them {np.mean(at_once >= 1):.1%}, two {np.mean(at_once >= 2):.1%}; {track}; "
        f"lamps burn {np.mean(burns):.0%}, cameras are at landmarks {np.mean(glances):.0%} of it",
    }
