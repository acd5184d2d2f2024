"""Depth across known edges: how many blocks with two depths are told one, and what is lost where there is no edge.

The same sweep (scenes.py) is measured with blocks that are split into their parts and with blocks that are not.
"""

from __future__ import annotations

import numpy as np

from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Value
from agent.perception.depth_sweep import clarity_of, measure
from tests.bench.pictures.scenes import FRAMES, stacks
from tests.bench.pictures.score import Score, score

BLOCK_PX = 40  # of pictures of 400
PAIRS = (("pink", "leaves"), ("leaves", "pink"), ("fine", "coarse"), ("coarse", "leaves"))
WAYS = ("whole", "split")


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    positions, blocks = np.arange(float(FRAMES)), {way: Score() for way in WAYS}
    for number, pair in enumerate(PAIRS):
        for stack in stacks(*pair, len(PAIRS) * seed + number):
            for way in WAYS:
                clarity = clarity_of(stack.images, positions, BLOCK_PX, 0.0, split=way == "split")
                blocks[way] += score(measure(clarity, BLOCK_PX, None), stack.truth, FRAMES - 1.0)
    return [{way: found._asdict() for way, found in blocks.items()}]


def summary(rows: Rows) -> dict[str, Value]:
    """Shares of all blocks of a kind, in hundredths."""
    figures: dict[str, Value] = {}
    for way in WAYS:
        counts = {key: sum(row[way][key] for row in rows["all"]) for key in Score._fields}
        for key in ("across_whole", "across_told", "across_wrong", "plain_told", "plain_wrong"):
            of = counts[key.split("_")[0]]
            figures[f"{way}_{key}"] = 100.0 * counts[key] / of if of else None
    return figures


CLAIM = Claim(
    run=run,
    summary=summary,
    measured_on="model",
    figures=(
        Figure("split_across_whole", "blocks across an edge that are told one depth", "%"),
        Figure("whole_across_whole", "the same if blocks are not split", "%"),
        Figure("split_across_told", "area of blocks across an edge that has a depth", "%"),
        Figure("split_across_wrong", "area of blocks across an edge that has a wrong one", "%"),
        Figure("split_plain_told", "area without an edge that has a depth", "%"),
        Figure("whole_plain_told", "the same if blocks are not split", "%"),
        Figure("split_plain_wrong", "area without an edge that has a wrong depth", "%"),
    ),
    explanation="""Two textured planes, one before the other, 1 to 8 half widths of a peak apart, through a lens with a
        real aperture: the nearer one blurs over the farther and hides part of it. A block lies across an edge where the
        smaller side has at least 15 % of it; one depth for all of it is wrong there. Each seed draws other textures and
        edges.""",
)
