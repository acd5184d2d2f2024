"""What one more lamp adds to a rendered frame of a camera in the dark."""

from __future__ import annotations

import time
from functools import partial

from agent.experiments.claim import Figure, Row
from agent.experiments.dark_water import DarkWater, stand
from tests.bench.timing import Settings, claim_of_costs, medians_ms, one_thread

AT_M = 1.25
STANDS = {"r1": stand(AT_M, 0.0), "r2": stand(0.72, 30.0), "r3": stand(0.72, -45.0)}
LIT = {"one": ("r1",), "three": tuple(STANDS)}


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Of whole frames of 640 x 480."""
    sea = DarkWater("harbour", seed)
    sea.prepare()
    lens_m = sea.sharp_m(AT_M)
    ways = {way: partial(sea.painter.light, sea.moment("r1", STANDS, lit), lens_m) for way, lit in LIT.items()}
    with one_thread():
        row = medians_ms(ways, settings.times, time.process_time)
    return [{**row, "lamp": (row["three"] - row["one"]) / 2.0}]


CLAIM = claim_of_costs(
    run=run,
    cases=("frame",),
    figures=(
        Figure("frame.one", "a frame of 640x480 by the own lamp", "ms"),
        Figure("frame.lamp", "one more lamp adds", "ms", most=10.0),
        Figure("frame.lamp/one", "one more lamp, over a frame by the own lamp", "times"),
    ),
    explanation="""A ball in harbour water, rendered by a robot's own lamp, and by those of two neighbours too: light on
        surfaces, shadows, and the veil in the water. Processor time, on this machine.""",
)
