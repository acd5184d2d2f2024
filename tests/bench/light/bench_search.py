"""Three robots that swim in search of a ball in the dark: when it is found and measured, by lent light and by own.

Whole kernels in virtual time (tests/capabilities/light/dark_search.py): no pictures, and what lamps show is the
kernel's own
model of light, in harbour water. By own lamps: nobody lends, so that in a search each lamp goes with its own camera.
Seeds by AUCAMP_SEARCH_SEEDS; length by AUCAMP_SEARCH_S.
"""

from __future__ import annotations

import os
from typing import Any

from msgspec.structs import replace

from tests.capabilities.light.dark_search import DarkSearch
from tests.capabilities.light.lit_swarm import HARBOUR

SEEDS = [int(seed) for seed in os.environ.get("AUCAMP_SEARCH_SEEDS", "11 12 13 14").split()]
SEARCH_S = float(os.environ.get("AUCAMP_SEARCH_S", "180"))
GAINS = {"lent light": HARBOUR.gain, "own lamps": 1e9}


def run() -> dict[str, dict[str, Any]]:
    found = {policy: [searched(seed, gain) for seed in SEEDS] for policy, gain in GAINS.items()}
    return {f"search by {policy}": figures(worlds) for policy, worlds in found.items()}


def searched(seed: int, gain: float) -> DarkSearch:
    """Until somebody has measured it, or time is up."""
    world = DarkSearch(seed, replace(HARBOUR, gain=gain))
    while not world.measured_s and world.seconds < SEARCH_S:
        world.step()
    return world


def figures(worlds: list[DarkSearch]) -> dict[str, Any]:
    firsts = [SEARCH_S if world.first_s is None else world.first_s for world in worlds]
    known = [min(world.measured_s.values(), default=SEARCH_S) for world in worlds]
    told = ", ".join(f"{first:.0f}/{at:.0f}" for first, at in zip(firsts, known, strict=True))
    return {
        "value": sum(known) / len(known),
        "unit": f"s until the ball is measured, mean of {len(worlds)} searches (at most {SEARCH_S:.0f})",
        "against": f"seen/measured after {told} s; looks by lent light: {[world.looks for world in worlds]}",
    }
