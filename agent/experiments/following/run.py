"""Can robots follow a target that swims, and what does it help that they talk and that they swim?

Each case is dived for many seeds; a seed is a world of its own: bodies, gimbals, survey, pull, the target's way, weeds,
and words that are lost. Closed loop with the kernel's agents, on the twin's bodies under the board's own firmware, with
drawn frames.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import msgspec

from agent.experiments.choices import FollowingPolicy
from agent.experiments.following.bars import verdicts
from agent.experiments.following.cases import Case, all_cases
from agent.experiments.following.counts import row_of
from agent.experiments.following.dive import WATCH_S, Draw, dive
from agent.experiments.pieces import Task, all_draws
from agent.experiments.result import ExperimentResult, Row
from agent.process.command import Progress

ENOUGH = 20  # seeds
WORLDS = 1000  # of one --seed
COST = 7  # CPU seconds of a robot in a draw, about


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # the first of the worlds
    seeds: int = ENOUGH
    only: FollowingPolicy | None = None  # this policy; none: all
    robots: int | None = None  # fleets of that size; none: all


class Result(ExperimentResult, frozen=True, kw_only=True):
    """A row for each case (counts.py)."""

    cases: list[Row]
    shown: Shown

    @property
    def failed(self) -> bool:
        return self.shown.verdict and any(verdict.met is False for verdict in verdicts(self.cases))


class Shown(NamedTuple):
    """Beside result.json."""

    draws: dict[Case, list[Draw]]
    verdict: bool  # seeds enough for one


def run(settings: Settings, progress: Progress) -> Result:
    """Dive all cases on all processors; progress counts seconds of work. Raises Failed where a firmware hangs."""
    chosen = all_cases(settings.only, settings.robots)
    first = WORLDS * settings.seed
    tasks = [Task(partial(worlds, case, first), settings.seeds, COST * case.robots, 1) for case in chosen]
    draws = dict(zip(chosen, all_draws(tasks, progress), strict=True))
    rows = [row_of(case, of) for case, of in draws.items()]
    return Result(cases=rows, shown=Shown(draws, settings.seeds >= ENOUGH))


def worlds(case: Case, world: int, first: int, last: int, watch_s: float = WATCH_S) -> list[Draw]:
    """The draws of worlds from the first to the last, the latter excluded, counted from `world`."""
    return [dive(case, world + k, watch_s) for k in range(first, last)]
