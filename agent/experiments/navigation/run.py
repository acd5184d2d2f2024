"""Where is a robot that swims, how well does it know, and does it do what it is told?

Each case is run for many seeds, and a seed is a world of its own: another body, lens, survey and pull. Fixes are made
of rendered frames; everything else is swum in closed loop with the kernel's agents, on the twin's bodies under the
board's own firmware, or on planar ones where there are many, and with tags drawn instead of rendered.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple, get_args

import msgspec

from agent.experiments.choices import NavigationCase
from agent.experiments.navigation.aid import AID_S as AID_S
from agent.experiments.navigation.aid import aided
from agent.experiments.navigation.bars import BARS, met
from agent.experiments.navigation.fix import PLACES, fixes
from agent.experiments.navigation.manoeuvres import goto, hold, orbit, turn
from agent.experiments.navigation.pursuit.follow import WATCH_S, follow
from agent.experiments.navigation.pursuit.search import SEARCH_S, search
from agent.experiments.navigation.separation import CROSSING_ROBOTS, CROSSING_S, crossing
from agent.experiments.navigation.summaries import SUMMARIES
from agent.experiments.navigation.target import SECONDS as TARGET_S
from agent.experiments.navigation.target import ball
from agent.experiments.pieces import Task, all_draws
from agent.experiments.result import ExperimentResult, Row
from agent.process.command import Progress

ENOUGH = 20  # seeds
WORLDS = 1000  # of one --seed
CASES: tuple[NavigationCase, ...] = get_args(NavigationCase)


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # the first of the worlds
    seeds: int = ENOUGH
    quick: bool = False  # one seed, and of that little
    only: NavigationCase | None = None  # this case; none: all


class Result(ExperimentResult, frozen=True, kw_only=True):
    """The figures of each case, empty where it was not run; which they are, and what they have to be, is in bars.py.

    shown: rows of each draw by name ("orbit", "orbit with gaps", ...), with their paths.
    """

    fix: Row
    hold: Row
    goto: Row
    turn: Row
    orbit: Row
    separation: Row
    target: Row
    aid: Row
    follow: Row
    search: Row
    shown: Shown

    @property
    def missed(self) -> list[str] | None:
        """Bars that are not met; None: too few seeds to tell."""
        if not self.shown.verdict:
            return None
        return [f"{bar.case} {bar.key}" for bar in BARS if met(bar, getattr(self, bar.case)) is False]

    @property
    def failed(self) -> bool:
        return bool(self.missed)


class Shown(NamedTuple):
    """Beside result.json."""

    draws: dict[str, list[Row]]
    verdict: bool  # seeds enough for one


class Draws(NamedTuple):
    """What is run for each seed, and for whose figures; cost: CPU seconds of a seed, about."""

    name: str
    case: NavigationCase
    draw: Callable[[int], Row | list[Row]]
    cost: int


def run(settings: Settings, progress: Progress) -> Result:
    """Run all cases on all processors; progress counts seconds of work. Raises Failed where a firmware hangs."""
    seeds = 1 if settings.quick else settings.seeds
    chosen = [one for one in all_cases(settings.quick) if settings.only in (None, one.case)]
    first = WORLDS * settings.seed
    found = all_draws([Task(partial(worlds, one.draw, first), seeds, one.cost, 1) for one in chosen], progress)
    draws = {one.name: rows for one, rows in zip(chosen, found, strict=True)}
    figures = {case: SUMMARIES[case](draws) if settings.only in (None, case) else {} for case in CASES}
    return Result(**figures, shown=Shown(draws, not settings.quick and seeds >= ENOUGH))


def all_cases(quick: bool) -> Sequence[Draws]:
    places, robots, seconds, aid_s = (3, 4, 10.0, 12.0) if quick else (PLACES, CROSSING_ROBOTS, CROSSING_S, AID_S)
    watch_s, search_s = (10.0, 30.0) if quick else (WATCH_S, SEARCH_S)
    return (
        Draws("fix", "fix", partial(fixes, places=places), 8),
        Draws("hold", "hold", hold, 3),
        Draws("goto", "goto", goto, 1),
        Draws("turn", "turn", turn, 1),
        Draws("orbit", "orbit", orbit, 3),
        Draws("orbit with gaps", "orbit", partial(orbit, gaps=True), 3),
        Draws("separation", "separation", partial(crossing, robots=robots, seconds=seconds), 14),
        Draws("target", "target", partial(ball, seconds=15.0 if quick else TARGET_S), 11),
        Draws("aid", "aid", partial(aided, seconds=aid_s), 3),
        Draws("aid with gyro", "aid", partial(aided, gyro=True, seconds=aid_s), 4),
        Draws("follow", "follow", partial(follow, watch_s=watch_s), 14),
        Draws("search", "search", partial(search, search_s=search_s), 8),
        Draws("search alone", "search", partial(search, robots=1, search_s=search_s), 3),
    )


def worlds(draw: Callable[[int], Row | list[Row]], world: int, first: int, last: int) -> list[Row]:
    """The draws of worlds from the first to the last, the latter excluded, counted from `world`."""
    found: list[Row] = []
    for k in range(first, last):
        rows = draw(world + k)
        found += rows if isinstance(rows, list) else [rows]
    return found
