"""What a fleet notices of what is wrong: how far off it is then, what it says of itself, and after how long."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import msgspec
import numpy as np

from agent.experiments.claim import Claim, Figure, Row, Rows, Share, Value, percentile
from agent.experiments.doubtful_fleet import BALL, FISH, MIDDLE_M, Array, Belief, Case, dive, moved_at, rests, swims

WRONG_S = 40.0  # from then on something is wrong, where it is not so from the start
NOTICED_S = 10.0  # so long it may go unnoticed
TOO_FAR = 9.0  # NEES beyond which a belief is wrong: 3 is honest


class Doubt(NamedTuple):
    """One row of the table."""

    words: str
    case: Callable[[int], Case]  # by seed
    from_start: bool = False  # wrong from the first message on


def ball(**about: object) -> Callable[[int], Case]:
    return lambda seed: Case(**{"path": rests, "target": BALL, **about})  # type: ignore[arg-type]


def fish(**about: object) -> Callable[[int], Case]:
    seen = {"target": FISH, "period_s": 0.1, "sees": (True, True, False)}
    return lambda seed: Case(**{"path": swims(seed), **seen, **about})  # type: ignore[arg-type]


def late(delay_s: float) -> Callable[[int, int, float], float]:
    return lambda i, j, s: delay_s


def knocked(i: int, s: float) -> Array:
    return np.array([0.06 * (i == 0 and s > WRONG_S), 0.0, 0.0])


def gone(s: float) -> Array | None:
    return rests(s) if s < WRONG_S else None


def creeps(s: float) -> Array:
    return np.asarray(MIDDLE_M + np.array([0.0, 1e-3 * max(s - WRONG_S, 0.0), 0.0]))


def apart(i: int, s: float) -> Array:
    return np.array([0.4 * i, 0.0, 0.0])


SIDE_RAD, ONE, LINE = math.radians(60.0), (True, False, False), (True, False, False, False, False)
BY_60, BY_20 = moved_at(WRONG_S, (0.0, 0.06, 0.0)), moved_at(WRONG_S, (0.0, 0.02, 0.0))
ROWS = {
    "ball": Doubt("a ball at rest, nothing wrong", ball(), True),
    "fish": Doubt("a fish, nothing wrong", fish(), True),
    "late-0.3": Doubt("a fish; all messages 0.3 s late", fish(delay_s=late(0.3)), True),
    "late-2": Doubt("a fish; all messages 2 s late", fish(delay_s=late(2.0)), True),
    "late-one-way": Doubt(
        "a fish; 0.6 s late to the blind robot alone", fish(delay_s=lambda i, j, s: 0.6 * (j == 2)), True
    ),
    "late-line": Doubt(
        "a fish; five in a line, the first sees, 0.3 s a hop", fish(delay_s=late(0.3), line=True, sees=LINE), True
    ),
    "lost": Doubt("a fish that all lose", fish(hidden=lambda i, s: s > WRONG_S)),
    "moved-60": Doubt("the ball is moved by 60 mm", ball(path=BY_60)),
    "moved-20": Doubt("the ball is moved by 20 mm", ball(path=BY_20)),
    "moved-60-one": Doubt("the ball is moved by 60 mm, one robot sees it", ball(path=BY_60, sees=ONE)),
    "creep": Doubt("the ball creeps by 1 mm/s", ball(path=creeps)),
    "removed": Doubt("the ball is taken away", ball(path=gone)),
    "removed-one": Doubt("the ball is taken away, one robot saw it", ball(path=gone, sees=ONE)),
    "knocked": Doubt("one of three robots is knocked by 60 mm", ball(offset_m=knocked)),
    "two-balls": Doubt("two robots see two balls, 0.4 m apart", ball(sees=(True, True), offset_m=apart), True),
    "long-2": Doubt("all ranges are 2 % long, robots all around", ball(long=(0.02,) * 3), True),
    "long-2-side": Doubt("the same, robots on one side", ball(long=(0.02,) * 3, spread_rad=SIDE_RAD), True),
    "table-3": Doubt("the focus table of one robot is 3 % long", ball(long=(0.03,)), True),
}


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seconds: float = 75.0


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """One dive: its beliefs after what is wrong had its time, and the first word other than `consistent`."""
    of = ROWS[case]
    since_s = 15.0 if of.from_start else WRONG_S  # a quarter of a minute: the fleet settles
    first: Belief | None = None
    late_on = []
    for belief in dive(of.case(seed), settings.seconds, seed):
        if first is None and belief.s > since_s and belief.verdict != "consistent":
            first = belief
        if belief.s > since_s + NOTICED_S:
            late_on.append(belief)
    known = [each for each in late_on if each.nees is not None]
    silent = sum(each.nees > TOO_FAR and each.verdict == "consistent" for each in known if each.nees is not None)
    if not known:  # it is there no more
        silent = sum(each.verdict == "consistent" for each in late_on)
    return [
        {
            "error_mm": 1e3 * float(np.mean([each.error_m for each in known])) if known else None,
            "sigma_mm": 1e3 * float(np.mean([each.sigma_m for each in known])) if known else None,
            "nees": float(np.mean([each.nees for each in known])) if known else None,
            "silent": silent / max(len(known or late_on), 1),
            "said_s": None if first is None else first.s - since_s,
            "word": "" if first is None else first.verdict,
            "cause": "" if first is None else first.causes[0],
        }
    ]


def summary(rows: Rows) -> dict[str, Value]:
    """Of a case: means, when half of the dives had said something, and the dives that are wrong in silence."""
    found: dict[str, Value] = {}
    for case, of in rows.items():
        for key in ("error_mm", "sigma_mm", "nees"):
            values = [row[key] for row in of if row[key] is not None]
            found[f"{case}.{key}"] = float(np.mean(values)) if values else math.nan
        said = [row["said_s"] for row in of]
        found[f"{case}.said"] = Share(sum(each is not None for each in said), len(of))
        found[f"{case}.said_s"] = percentile(said, 50.0)
        found[f"{case}.heard"] = Share(sum(row["silent"] <= 0.05 for row in of), len(of))
    return found


def figures() -> tuple[Figure, ...]:
    found = []
    for case, of in ROWS.items():
        nothing = case in ("ball", "fish")
        found.append(Figure(f"{case}.error_mm", f"{of.words}: error", "mm"))
        found.append(Figure(f"{case}.sigma_mm", "it says", "mm"))
        found.append(Figure(f"{case}.nees", "NEES", "", least=2.5 if nothing else None, most=3.5 if nothing else None))
        if nothing:
            found.append(Figure(f"{case}.said", "dives in which something is said", "%", most=5.0))
        else:
            found.append(Figure(f"{case}.said_s", "said after, half of the dives", "s"))
            found.append(Figure(f"{case}.heard", "dives not wrong in silence", "%", least=90.0))
    return tuple(found)


CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(ROWS),
    quick={"seconds": 20.0},
    measured_on="model",
    figures=figures(),
    explanation="""The kernel's own targets agree over links that delay, on samples that are drawn; nothing is rendered.
        A belief is wrong in silence where its NEES is above 9 and the robot's word is `consistent`, ten seconds after
        what is wrong began; a dive counts as not silent where fewer than one belief in twenty is. What is not in the
        table was not tried: errors of level and survey that all robots share cannot be noticed from the data.""",
)
