"""Depth across known edges: how many blocks with two depths are told one, and what is lost where there is no edge.

One textured plane stands before another (scenes.py), and the same sweep is measured with blocks that are split into
their parts and with blocks that are not.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Value
from agent.perception.depth_sweep import clarity_of, measure
from tests.bench.pictures.scenes import FRAMES, Stack, stacks
from tests.bench.pictures.score import Score, score

BLOCK_PX = 40  # of pictures of 400
PAIRS = (("pink", "leaves"), ("leaves", "pink"), ("fine", "coarse"), ("coarse", "leaves"))
CASES = {"drawn": "drawn textures", "photographs": "real photographs as textures"}


def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """Raises ConfigError where the photographs are absent."""
    positions, blocks = np.arange(float(FRAMES)), {"whole": Score(), "split": Score()}
    for stack in drawn(seed) if case == "drawn" else stacks("photograph", "photograph", seed):
        for way in blocks:
            found = measure(clarity_of(stack.images, positions, BLOCK_PX, 0.0, split=way == "split"), BLOCK_PX, None)
            blocks[way] += score(found, stack.truth, FRAMES - 1.0)
    return [{way: found._asdict() for way, found in blocks.items()}]


def drawn(seed: int) -> Iterator[Stack]:
    for number, pair in enumerate(PAIRS):
        yield from stacks(*pair, len(PAIRS) * seed + number)


def summary(rows: Rows) -> dict[str, Value]:
    """Shares of all blocks of a kind, in hundredths."""
    figures: dict[str, Value] = {}
    for case, of_case in rows.items():
        for way in ("whole", "split"):
            counts = {key: sum(row[way][key] for row in of_case) for key in Score._fields}
            for key in ("across_whole", "across_told", "across_wrong", "plain_told", "plain_wrong"):
                of = counts[key.split("_")[0]]
                figures[f"{case}_{way}_{key}"] = 100.0 * counts[key] / of if of else None
    return figures


CLAIM = Claim(
    run=run,
    summary=summary,
    cases=tuple(CASES),
    measured_on="model",
    figures=tuple(
        Figure(f"{case}_{way}_{key}", f"{words}: {what}", "%")
        for case, words in CASES.items()
        for way, key, what in (
            ("split", "across_whole", "blocks across an edge that are told one depth"),
            ("whole", "across_whole", "the same if blocks are not split"),
            ("split", "across_told", "area of blocks across an edge that has a depth"),
            ("split", "across_wrong", "area of blocks across an edge that has a wrong one"),
            ("split", "plain_told", "area without an edge that has a depth"),
            ("whole", "plain_told", "the same if blocks are not split"),
            ("split", "plain_wrong", "area without an edge that has a wrong depth"),
        )
    ),
    explanation="""Two textured planes, one before the other, 1 to 8 half widths of a peak apart, through a lens with a
        real aperture: the nearer one blurs over the farther and hides part of it. A block lies across an edge where the
        smaller side has at least 15 % of it; one depth for all of it is wrong there. Each seed draws other textures and
        edges.""",
)
