"""Three robots that swim in search of a fish in the dark: when one of them sees it, by lent light and by own.

Whole kernels in virtual time (tests/capabilities/light/dark_fish.py): no pictures, and what lamps show is the
kernel's own model of light, in harbour water. Seeds by AUCAMP_FISH_SEARCH_SEEDS; length by AUCAMP_FISH_SEARCH_S.
"""

from __future__ import annotations

import os
import statistics
from typing import Any
from unittest.mock import patch

from tests.capabilities.light.dark_fish import DarkFish

SEEDS = [int(seed) for seed in os.environ.get("AUCAMP_FISH_SEARCH_SEEDS", "").split()] or list(range(100, 120))
SEARCH_S = float(os.environ.get("AUCAMP_FISH_SEARCH_S", "120"))
SPEED_M_S = 0.15
AFTER_S = {"lent light from the beginning": 0.0, "lent light after 20 s": 20.0, "own lamps": 1e6}  # of own looks


def run() -> dict[str, dict[str, Any]]:
    found = {policy: [searched(seed, after_s) for seed in SEEDS] for policy, after_s in AFTER_S.items()}
    own = [first_s for first_s, _ in found["own lamps"]]
    return {f"fish searched by {policy}": figures(dives, own) for policy, dives in found.items()}


def searched(seed: int, after_s: float) -> tuple[float, int]:
    """When one of them saw it, s, and how many looks were by lent light until then."""
    with patch("agent.capabilities.light.light_request.OWN_SCAN_NS", round(after_s * 1e9)):
        world = DarkFish(seed, SPEED_M_S, SEARCH_S + 1.0)
        while not (world.saw and any(world.saw[-1])) and world.seconds < SEARCH_S:
            world.step()
    return world.seconds, world.looks


def figures(dives: list[tuple[float, int]], own: list[float]) -> dict[str, Any]:
    firsts = [first_s for first_s, _ in dives]
    sooner, later = (sum(sign * (at - by) > 0.0 for at, by in zip(firsts, own, strict=True)) for sign in (-1, 1))
    return {
        "value": statistics.mean(firsts),
        "unit": f"s until one of three sees it, mean of {len(firsts)} searches (at most {SEARCH_S:.0f})",
        "against": f"median {statistics.median(firsts):.1f}, longest {max(firsts):.1f} s; sooner than by own lamps in "
        f"{sooner}, later in {later}; looks by lent light: {sum(looks for _, looks in dives)}",
    }
