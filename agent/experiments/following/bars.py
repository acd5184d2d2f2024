"""What three robots that share have to show on the twin, at each speed, and what lost words may cost them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from agent.experiments.following.cases import FLEET
from agent.experiments.result import Row


class Bar(NamedTuple):
    """A figure of a case, and where it has to lie; None: no limit."""

    key: str
    least: float | None
    most: float | None
    words: str


class Verdict(NamedTuple):
    """Of one case. value and met: None where there is no number, which misses a bar, or the case was not run."""

    bar: Bar
    case: Row
    value: float | None
    met: bool


BARS = (
    Bar("seen_by_one", 0.99, None, "one or more see it"),
    Bar("seen_by_two", 0.95, None, "two or more see it"),
    Bar("seen_each", 0.88, None, "each sees it"),
    Bar("rms_mm", None, 25.0, "the fleet's track, mm rms"),
    Bar("nees", 2.5, 3.5, "its normalised error squared"),
    Bar("reacquire_p95_s", None, 0.3, "seen again, others see it, s"),
    Bar("reacquire_alone_p95_s", None, 1.0, "seen again, nobody sees it, s"),
)
COSTS = Bar("rms_mm", None, 1.10, "error with 30 % of words lost, times that without loss")


def verdicts(cases: Sequence[Row]) -> list[Verdict]:
    """Of three robots that share and lose no words at all bars, and of those that do at what it costs them. Nobody who
    never loses it can be late in finding it again."""
    found = []
    for case in cases:
        if case["policy"] != "share" or case["robots"] != FLEET:
            continue
        if not case["loss"]:
            found += [
                Verdict(bar, case, case[bar.key], _meets(bar, case[bar.key])) for bar in BARS if _asked(bar, case)
            ]
            continue
        free = [one for one in cases if _without_loss(one, case)]
        if free:
            value = None if None in (case["rms_mm"], free[0]["rms_mm"]) else case["rms_mm"] / free[0]["rms_mm"]
            found.append(Verdict(COSTS, case, value, _meets(COSTS, value)))
    return found


def _asked(bar: Bar, case: Row) -> bool:
    of = {"reacquire_p95_s": "losses", "reacquire_alone_p95_s": "losses_alone"}.get(bar.key)
    return of is None or case[of] > 0


def _without_loss(one: Row, case: Row) -> bool:
    return not one["loss"] and all(one[key] == case[key] for key in ("policy", "robots", "speed_m_s"))


def _meets(bar: Bar, value: float | None) -> bool:
    return value is not None and (bar.least is None or value >= bar.least) and (bar.most is None or value <= bar.most)
