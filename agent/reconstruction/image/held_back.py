"""Which pictures nothing is made of, so that what is rendered can be held against them."""

from __future__ import annotations

from collections.abc import Sequence

from agent.reconstruction.view import View

ENOUGH = 12  # views from which on some can be spared
EVERY = 10


def held_back(views: Sequence[View]) -> tuple[list[View], list[View]]:
    """Views to build from, and one in EVERY to judge by, each in order; none where there are fewer than ENOUGH."""
    if len(views) < ENOUGH:
        return list(views), []
    spared = range(EVERY // 2, len(views), EVERY)
    return [view for n, view in enumerate(views) if n not in spared], [views[n] for n in spared]
