"""What an enhancement is worth on real pairs: beside the simple methods, and on scenes that it was not trained on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np
from rich.table import Table

from agent.perception.enhancement.grey_world import clahe, white_balance
from agent.perception.enhancement.lu2net import LU2Net, run
from agent.training.dataset import Pairs
from agent.training.degrade import Image
from agent.training.metrics import Quality, judge
from agent.training.scene_pairs import folds
from agent.training.train import Plan, Run, advance

Method = Callable[[Image], Image]


class Fold(NamedTuple):
    """One round of cross-validation: how many pairs were held out, and the figures of each before and after."""

    number: int
    held_out: int
    before: Quality
    after: list[Quality]


SIMPLE: dict[str, Method] = {"identity": lambda image: image, "grey world": white_balance, "CLAHE": clahe}


def score(pairs: Pairs, method: Method) -> list[Quality]:
    """What a method makes of each pair."""
    return [judge(method(raw), target) for raw, target in zip(pairs.raw, pairs.target, strict=True)]


def mean(figures: list[Quality]) -> Quality:
    """Each figure by itself."""
    return Quality(*np.mean(figures, axis=0).tolist())


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
        before, after = (score(held_out, partial(run, net)) for net in (start, state.average.eval()))
        yield Fold(number + 1, len(held_out.raw), mean(before), after)


def table(rows: dict[str, Quality], title: str) -> Table:
    """A line for each method."""
    out = Table(title=title)
    for heading in ("", "PSNR dB", "SSIM", "UCIQE", "UIQM"):
        out.add_column(heading, justify="left" if not heading else "right")
    for name, q in rows.items():
        out.add_row(name, f"{q.psnr_db:.2f}", f"{q.ssim:.3f}", f"{q.uciqe:.3f}", f"{q.uiqm:.3f}")
    return out
