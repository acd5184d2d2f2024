"""What an enhancement is worth on real pairs: beside the simple methods, and on scenes that it was not trained on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from agent.perception.enhancement.enhance import network_enhancer
from agent.perception.enhancement.grey_world import clahe, classic, white_balance
from agent.perception.enhancement.lu2net import LU2Net, run
from agent.tools.dataset import Pairs
from agent.tools.degrade import Image
from agent.tools.metrics import Quality, judge
from agent.tools.scene_pairs import folds
from agent.tools.train import Plan, Run, advance, between

Method = Callable[[Image], Image]


class Fold(NamedTuple):
    """One round of cross-validation: the figures of each pair that was held out."""

    number: int
    raw: list[Quality]  # as they are
    before: list[Quality]  # by the weights that were given, the fast way
    plain: list[Quality]  # by those that were tuned on the other folds, in full
    fast: list[Quality]  # and the fast way, which is what users get


SIMPLE: dict[str, Method] = {
    "identity": lambda image: image,
    "grey-world": white_balance,
    "CLAHE": clahe,
    "classic": classic,
}


def score(pairs: Pairs, method: Method) -> list[Quality]:
    """What a method makes of each pair."""
    return [judge(method(raw), target) for raw, target in zip(pairs.raw, pairs.target, strict=True)]


def cross_validate(start: LU2Net, pairs: Pairs, plan: Plan, count: int) -> Iterator[float | Fold]:
    """Fine-tune `start` on all scenes but a fold's, for each fold; yields each step's loss, and each fold when done.

    The number of steps is fixed beforehand: nothing is chosen by looking at what is held out.
    Raises ConfigError if there are fewer scenes than folds.
    """
    fold_of = folds(pairs.scene, count, plan.seed)
    nothing = pairs.only(np.zeros(len(pairs.raw), bool))
    for number in range(count):
        held_out = pairs.only(fold_of == number)
        state = Run(plan, start)
        yield from advance(state, pairs.only(fold_of != number), nothing)
        tuned = between(start, state.average)
        methods = SIMPLE["identity"], fast(start), partial(run, tuned), fast(tuned)
        yield Fold(number + 1, *(score(held_out, method) for method in methods))


def fast(net: LU2Net) -> Method:
    return network_enhancer(net, "fast").apply
