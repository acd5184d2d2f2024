"""Keyframes of a survey in the dark, of three robots at rest: blocks with a peak, by which lamps.

Each robot takes the view that it would take of a basin of which nothing is known (dark_views.py). `ahead`: its own lamp
alone, aimed a metre ahead as it goes with the camera; `own`: the same, aimed at what the view is to show; `all`: every
lamp burns and goes with its own camera; `rule`: by lighting/frames.py, where all truly are. `changed`: `all`, and the
others' go dark half-way through the sweep, as they turn away when nobody holds a lease. The rule was set by the
keyframes of seed 0. Seeds by AUCAMP_KEYFRAME_SEEDS, waters by AUCAMP_KEYFRAME_WATERS, places by AUCAMP_KEYFRAME_FLEETS.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

from tests.bench.light.dark_views import WATERS, Basin, Swept

SEEDS = [int(seed) for seed in os.environ.get("AUCAMP_KEYFRAME_SEEDS", "3").split()]
IN_WATERS = os.environ.get("AUCAMP_KEYFRAME_WATERS", " ".join(WATERS)).split()
FLEETS = int(os.environ.get("AUCAMP_KEYFRAME_FLEETS", "4"))  # drawn places of three robots
POLICIES = ("ahead", "own", "all", "changed", "rule")


def run() -> dict[str, dict[str, Any]]:
    return {
        f"keyframes: {water}, seed {seed}": figures(list(views(water, seed))) for water in IN_WATERS for seed in SEEDS
    }


def views(water: str, seed: int) -> Iterator[tuple[dict[str, Swept], bool]]:
    """Of each view what each policy's lamps show, and whether the rule borrowed any."""
    basin = Basin(water, seed)
    for number in range(FLEETS):
        posed = basin.robots(number)
        for name, one in posed.items():
            choice, aim_m = basin.chosen(one, posed), basin.scene_of(one).aim_m
            beams = {f"{other}'s view": basin.beam(posed[other], basin.ahead_m(posed[other])) for other in posed}
            beams |= {other: basin.beam(posed[other], aim_m) for other in {name, *choice.lamps}}
            ahead, all_on = [f"{name}'s view"], [f"{other}'s view" for other in posed]
            sets = {"ahead": ahead, "own": [name], "all": all_on, "changed": all_on, "rule": list(choice.lamps)}
            yield basin.swept(one, posed, beams, sets, {"changed": ahead}), set(choice.lamps) != {name}


def figures(rows: list[tuple[dict[str, Swept], bool]]) -> dict[str, Any]:
    mean = {policy: sum(row[policy].right for row, _ in rows) / len(rows) for policy in POLICIES}
    wrong = {policy: sum(row[policy].wrong for row, _ in rows) / len(rows) for policy in POLICIES}
    lent = [row for row, borrowed in rows if borrowed]
    worse = sum(row["rule"].right < row["own"].right for row in lent)
    told = "; ".join(f"{policy} {mean[policy]:.0f} ({wrong[policy]:.0f} wrong)" for policy in POLICIES[:-1])
    gain = sum(row["rule"].right for row in lent) / max(sum(row["own"].right for row in lent), 1)
    return {
        "value": mean["rule"],
        "unit": f"blocks a keyframe by the rule ({wrong['rule']:.0f} wrong), of {len(rows)} keyframes",
        "against": f"{told}; lent light in {len(lent)}: {gain:.2f} of the own lamp's blocks, fewer in {worse}",
        "ratio": mean["rule"] / mean["own"] if mean["own"] else None,
    }
