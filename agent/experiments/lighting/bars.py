"""What the rule has to be worth, and which of it a run misses."""

from __future__ import annotations

from collections.abc import Sequence

from agent.experiments.result import Row

ENOUGH = 4  # fleets of each size: with fewer there is no verdict
AT_M, SIGMA_SHARE, RANGE_TIMES = 1.25, 0.25, 1.5  # harbour
USABLE, BELOW_OPTIMUM = 0.75, 0.05  # of five robots, harbour
FIRST_ORDER, ALL_ORDERS, MS_PER_LAMP, CORRELATION = 0.02, 0.30, 10.0, -0.85


def missed(cases: Sequence[Row], model: Row, scenes: int) -> list[str]:
    """In words, for tables and result.json."""
    found: list[str] = []
    if scenes < ENOUGH:
        return found
    ladder = {
        (row["policy"], row["distance_m"]): row
        for row in cases
        if row["water"] == "harbour" and row["distance_m"] is not None
    }
    if ladder:
        own, rule = (ladder[policy, AT_M]["sigma_mm"] for policy in ("own", "rule"))
        if rule is None or (own is not None and rule > SIGMA_SHARE * own):
            found.append(f"sigma at {AT_M} m in harbour water: more than {SIGMA_SHARE} of the own lamp's")
        if reach_m(ladder, "rule") < RANGE_TIMES * reach_m(ladder, "own"):
            found.append(f"accepted range in harbour water: less than {RANGE_TIMES} times the own lamp's")
    fleets = {
        (row["water"], row["robots"], row["policy"]): row["usable_share"]
        for row in cases
        if row["distance_m"] is None and not row["loss"]
    }
    for (water, robots, policy), share in fleets.items():
        if policy == "own" and fleets[water, robots, "rule"] < share:
            found.append(f"{robots} robots in {water}: fewer have a range than with their own lamps")
    if ("harbour", 5, "rule") in fleets:
        rule = fleets["harbour", 5, "rule"]
        if rule < USABLE:
            found.append(f"five robots in harbour water: fewer than {100 * USABLE:.0f} % have a range")
        if rule < fleets["harbour", 5, "optimum"] - BELOW_OPTIMUM:
            found.append(f"five robots in harbour water: more than {100 * BELOW_OPTIMUM:.0f} points below the optimum")
    for key, bar in (("veil_first_order", FIRST_ORDER), ("veil_all_orders", ALL_ORDERS)):
        found += [f"{who}{key}" for who in ("", "twin_") if model[who + key] > bar]
    if model["ms_per_lamp"] > MS_PER_LAMP:
        found.append("ms_per_lamp")
    found += [
        f"correlation of log J with log sigma, {water}"
        for water, value in model["correlation"].items()
        if value is not None and value > CORRELATION
    ]
    return found


def reach_m(ladder: dict[tuple[str, float], Row], policy: str) -> float:
    """The farthest distance at which at least half of the sweeps have a peak."""
    return max((d for (who, d), row in ladder.items() if who == policy and row["accepted"] >= 0.5), default=0.0)
