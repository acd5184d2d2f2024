"""Sweeps in the dark by lamps that are lent, in bad weather: which of them counted though a lamp changed.

Whole kernels in virtual time, whose lamps are watched apart from what robots say of them.
"""

from __future__ import annotations

import msgspec

from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value
from tests.capabilities.light.lit_swarm import LitSwarm, Weather

WEATHERS = {
    "loss30": Weather(loss=0.3),
    "storm": Weather(loss=0.3, late=0.1, twice=0.1, restarts_hz=0.02, disarmed_hz=0.02),
}


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    dive_s: float = 300.0  # of virtual time: about two sweeps in three seconds


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One dive of three robots."""
    swarm = LitSwarm(WEATHERS[case], seed)
    swarm.run(settings.dive_s)
    wrong = sum(bool(sweep.altered) for sweep in swarm.kept)
    lent = sum(set(sweep.lamps) != {sweep.robot} for sweep in swarm.kept)
    spoiled = sum(why.startswith("spoiled") for why in swarm.rejected)
    others = len(swarm.rejected) - spoiled
    return [{"counted": len(swarm.kept), "wrong": wrong, "lent": lent, "spoiled": spoiled, "others": others}]


def summary(rows: Rows) -> dict[str, Value]:
    found: dict[str, Value] = {}
    for case, dives in rows.items():
        total = {key: sum(dive[key] for dive in dives) for key in dives[0]}
        swept = total["counted"] + total["spoiled"] + total["others"]
        found |= {
            f"{case}_wrong": Share(total["wrong"], total["counted"]),
            f"{case}_spoiled": Share(total["spoiled"], swept),
            f"{case}_lent": Share(total["lent"], total["counted"]),
        }
    return found


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"dive_s": 20.0},
    cases=tuple(WEATHERS),
    measured_on="model",
    figures=tuple(
        figure
        for case, words in (
            ("loss30", "30 % of messages lost"),
            ("storm", "as many lost, some late and twice, robots restart and are disarmed"),
        )
        for figure in (
            Figure(f"{case}_wrong", f"{words}: sweeps that counted though a lamp changed", "%", most=0.1),
            Figure(f"{case}_spoiled", "sweeps that were discarded because one did", "%"),
            Figure(f"{case}_lent", "sweeps that counted, by borrowed light", "%"),
        )
    ),
    explanation="""Three robots sweep by each other's lamps, by a rule that lends all. No sweep may count while a lamp
        changed in it; of none wrong in a few thousand the interval still has an end above nothing, which the target
        allows. Each seed is a dive of five minutes with chance of its own.""",
)
