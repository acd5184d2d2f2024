"""Sweeps in the dark by lamps that are lent, at 30 % loss and worse: which of them counted though a lamp changed.

Whole kernels in virtual time (tests/capabilities/light/lit_swarm.py), whose lamps are watched apart from what robots
say of them. No clock in it: the figures are always the same.
"""

import os

from tests.capabilities.light.lit_swarm import LitSwarm, Weather

SWEEPS = int(os.environ.get("AUCAMP_LEASE_SWEEPS", "1000"))
PART_S = 20.0
WEATHERS = {
    "30 % lost": Weather(loss=0.3),
    "30 % lost, late, twice, restarts, disarmed": Weather(0.3, 0.1, 0.1, 0.02, 0.02),
}


def run() -> dict[str, dict]:
    return {f"leases: {name}": swept(weather) for name, weather in WEATHERS.items()}


def swept(weather: Weather) -> dict:
    """Until so many sweeps counted, by dives of different seeds."""
    kept, spoiled, dive_s, seed = [], 0, 0.0, 0
    while len(kept) < SWEEPS:
        swarm, seed = LitSwarm(weather, seed), seed + 1
        for _ in range(15):
            swarm.run(PART_S)
            dive_s += PART_S
            if len(kept) + len(swarm.kept) >= SWEEPS:
                break
        kept += swarm.kept
        spoiled += sum(why.startswith("spoiled") for why in swarm.rejected)
    wrong = sum(bool(sweep.altered) for sweep in kept)
    lent = sum(set(sweep.lamps) != {sweep.robot} for sweep in kept)
    return {
        "value": wrong,
        "unit": f"sweeps that counted though a lamp changed, of {len(kept)}",
        "against": f"{spoiled} discarded, {lent} by borrowed light, one each {dive_s / len(kept):.1f} s",
        "ratio": wrong / len(kept),
    }
