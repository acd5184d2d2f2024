"""How close to the target do robots come together, and how close could they come?

The error is the root mean square of the 3-D distance to the target over draws and over the robots that have an
estimate, those that are wrong on purpose left out.

All protocols see the same draws, and so does a central fusion that has every sample; its error is known beforehand: it
is the bound. What its mean square is off the bound is the luck of these draws, and is taken off all others' (a control
variate with coefficient 1: unbiased, and tens of draws do the work of thousands for a protocol near the bound).
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import msgspec

from agent.experiments.claim import Claim, Figure, Row, Rows, Value
from agent.experiments.localization.draws import Case, Score, closed_form_m, score_draw, world_of
from agent.experiments.localization.lockstep import graph, paper_weights

# --- cases: each has a few swarms; the names of these are in the figures' ---

CASES: dict[str, dict[str, Case]] = {
    # Nothing goes wrong: what averaging reaches is known beforehand.
    "closed-form": {
        "paper-full": Case("paper", "full", 3, 10, (10, 50), noise="iso"),
        "paper-ring": Case("paper", "ring", 10, 10, (10, 50), noise="iso"),
        "paper-line": Case("paper", "line", 10, 10, (10, 50), noise="iso"),
    },
    # Ten robots on the hard graph. One message an iteration, as in the paper; and ten, as the agents send by default.
    # What is measured in an iteration is heard in the next one: with one message, news travels one hop an iteration.
    "bad-links": {
        "paper": Case("paper", "geometric", 10, 40, (10, 50, 200), loss=0.3),
        "metropolis": Case("metropolis", "geometric", 10, 10, (10, 50, 200), loss=0.3),
        "evidence": Case("evidence", "geometric", 10, 5, (10, 50, 200), loss=0.3),
        "evidence-often": Case("evidence", "geometric", 10, 2, (10, 50), loss=0.3, says=10),
    },
    # The paper's own experiment: views from iterations 0, 16 and 28.
    "late-views": {
        "paper-late": Case("paper", "full", 3, 5, (45,), views="paper"),
        "evidence-late": Case("evidence", "full", 3, 5, (45,), views="paper"),
        "paper-late-lossy": Case("paper", "full", 3, 5, (45,), loss=0.3, views="paper"),
        "evidence-late-lossy": Case("evidence", "full", 3, 5, (45,), loss=0.3, views="paper"),
    },
    # Three of ten see.
    "relays": {
        "paper-line-relayed": Case("paper", "line", 10, 2, (10, 50), loss=0.1, views="relay"),
        "paper-relayed": Case("paper", "geometric", 10, 2, (10, 50), loss=0.1, views="relay"),
        "evidence-line-relayed": Case("evidence", "line", 10, 2, (10, 50), loss=0.1, views="relay"),
        "evidence-relayed": Case("evidence", "geometric", 10, 2, (10, 50), loss=0.1, views="relay"),
    },
    # Robot 0 is 300 mm off, in realistic company.
    "one-wrong": {
        "paper-wrong": Case("paper", "full", 3, 8, (10, 60), loss=0.1, systematic=True, outlier_mm=300.0),
        "metropolis-wrong": Case("metropolis", "full", 3, 8, (10, 60), loss=0.1, systematic=True, outlier_mm=300.0),
        "evidence-wrong": Case("evidence", "full", 3, 8, (10, 60), loss=0.1, systematic=True, outlier_mm=300.0),
        "evidence-wrong-10": Case(
            "evidence", "geometric", 10, 2, (10, 60), loss=0.1, systematic=True, outlier_mm=300.0
        ),
    },
    # Does a robot know how wrong it is, and what does it cost to doubt the others where none is wrong? Robots that
    # share all they know are wrong together: only draws count.
    "honest-covariance": {
        "honest-3": Case("evidence", "full", 3, 30, (10, 60), systematic=True),
        "honest-5": Case("evidence", "full", 5, 20, (10, 60), systematic=True),
        "honest-10": Case("evidence", "full", 10, 10, (10, 60), systematic=True),
    },
    # A target that swims in circles. Old news is wrong news: one message a second, ten (the agents' rate), and
    # iterations five times as frequent as samples.
    "moving": {
        "moving": Case("evidence", "geometric", 10, 1, (60,), loss=0.3, speed_mm_s=20.0),
        "moving-often": Case("evidence", "geometric", 10, 1, (60,), loss=0.3, speed_mm_s=20.0, says=10),
        "moving-fast": Case("evidence", "geometric", 10, 1, (60,), loss=0.3, speed_mm_s=20.0, ticks=5),
    },
    "moving-wrong": {
        "moving-3-wrong": Case(
            "evidence", "full", 3, 1, (60,), loss=0.3, systematic=True, outlier_mm=300.0, speed_mm_s=20.0, says=10
        )
    },
}


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked; each swarm has its own draws and iterations."""

    draws: int = 100  # of a swarm in a seed, at most
    iterations: int = 200  # at most


def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """A row for each swarm and each iteration at which it is scored."""
    found: list[Row] = []
    for name, swarm in CASES[case].items():
        at = tuple(sorted({min(t, settings.iterations) for t in swarm.at}))
        asked = swarm._replace(at=at, draws=min(settings.draws, swarm.draws))
        found += rows_of(name, asked, [score_draw(asked, seed, number) for number in range(asked.draws)])
    return found


def rows_of(name: str, swarm: Case, found: Sequence[Sequence[Score]]) -> Iterator[Row]:
    """Sums over the draws, squares in m^2; `known`: draws in which any robot has an estimate."""
    for t, scores in zip(swarm.at, zip(*found, strict=True), strict=True):
        known = [(s.square, s.nees) for s in scores if s.square is not None and s.nees is not None]
        yield {
            "swarm": name,
            "t": t,
            "draws": len(scores),
            "known": len(known),
            "square": math.fsum(square for square, _ in known),
            "nees": math.fsum(nees for _, nees in known),
            "covered": math.fsum(s.covered for s in scores),
            "central": math.fsum(s.central for s in scores),
            "bound": math.fsum(s.bound for s in scores),
            "theory_m": theory_m(swarm, t),
        }


def theory_m(swarm: Case, t: int) -> float | None:
    """What the paper's averaging must reach where its theorem applies: all see, nothing is lost, nothing is biased."""
    spoilt = swarm.loss or swarm.views != "all" or swarm.systematic or swarm.outlier_mm or swarm.speed_mm_s
    if swarm.protocol != "paper" or spoilt:
        return None
    return closed_form_m(paper_weights(graph(swarm.topology, swarm.robots)), world_of(swarm).random_m2, t)


# --- figures ---

SWARMS = {name: swarm for swarms in CASES.values() for name, swarm in swarms.items()}
Kind = Literal["mm", "ratio", "theory", "nees", "knows"]  # error, over the bound, over the theorem; see `Score`
SUMS = ("draws", "known", "square", "nees", "covered", "central", "bound")


def summary(rows: Rows) -> dict[str, Value]:
    """All kinds of figures of every swarm and iteration."""
    batches: dict[tuple[str, int], list[Row]] = defaultdict(list)
    for of_case in rows.values():
        for row in of_case:
            batches[row["swarm"], row["t"]].append(row)
    return {
        key(name, kind, t): value for (name, t), batch in batches.items() for kind, value in figures_of(batch).items()
    }


def figures_of(batch: Sequence[Row]) -> dict[Kind, float | None]:
    """Of one swarm at one iteration. The luck of its draws is taken off the error."""
    draws, known, square, nees, covered, central, bound = (sum([row[name] for row in batch]) for name in SUMS)
    theory_m = batch[0]["theory_m"]
    error_m = math.sqrt(max(square / known - (central - bound) / draws, 0.0)) if known else None
    return {
        "mm": None if error_m is None else 1e3 * error_m,
        "ratio": None if error_m is None else error_m / math.sqrt(bound / draws),
        "theory": None if error_m is None or theory_m is None else error_m / theory_m,
        "nees": nees / known if known else None,
        "knows": covered / draws,
    }


def key(name: str, kind: Kind, t: int) -> str:
    """The iteration counts where there are several."""
    return f"{name}_{kind}_{t}" if len(SWARMS[name].at) > 1 else f"{name}_{kind}"


Limit = float | Mapping[int, float] | None  # at each iteration, or by it


def at_each(name: str, kind: Kind, words: str, least: Limit = None, most: Limit = None) -> Iterator[Figure]:
    """A figure for each iteration at which this swarm is scored."""
    at, unit = SWARMS[name].at, "mm" if kind == "mm" else ""
    for t in at:
        when = f"{words}, t = {t}" if len(at) > 1 else words
        yield Figure(key(name, kind, t), when, unit, least=limit(least, t), most=limit(most, t))


def limit(of: Limit, t: int) -> float | None:
    return of[t] if isinstance(of, Mapping) else of


# Times the bound: the literal update on the hard graph at 30 % loss, and the share by which that may be missed, for
# these are 150 draws of another world.
PAPER_UNDER_LOSS, REPRODUCED = {10: 9.6, 50: 27.0, 200: 56.0}, 0.10
FAILS_LEAST = {t: (1.0 - REPRODUCED) * times for t, times in PAPER_UNDER_LOSS.items()}
FAILS_MOST = {t: (1.0 + REPRODUCED) * times for t, times in PAPER_UNDER_LOSS.items()}
EVIDENCE_UNDER_LOSS = {10: 1.25, 50: 1.15, 200: 1.05}  # times the bound
HONEST_COMPANY = {3: 1.035, 5: 1.035, 10: 1.040}  # times the bound with errors that stay: what it costs to doubt
WRONG = 1.1  # times the bound of those that are not
MOVING = 1.5  # times the central filter's error
THEOREM = 0.95, 1.05
NEES = 2.5, 3.5

FIGURES = (
    *at_each("evidence", "ratio", "10 robots, 30 % lost: error over the bound", most=EVIDENCE_UNDER_LOSS),
    *at_each("evidence-often", "ratio", "ten messages an iteration", most=EVIDENCE_UNDER_LOSS),
    *at_each("paper", "ratio", "the paper's protocol there: fails as known", FAILS_LEAST, FAILS_MOST),
    *at_each("metropolis", "ratio", "Metropolis averaging there"),
    *at_each("paper-full", "theory", "3 robots, nothing lost: the paper's error over its theorem's", *THEOREM),
    *at_each("paper-ring", "theory", "10 robots in a ring", *THEOREM),
    *at_each("paper-line", "theory", "10 robots in a line", *THEOREM),
    *at_each("evidence-late", "ratio", "views from 0, 16 and 28, t = 45: error over the bound"),
    *at_each("evidence-late-lossy", "ratio", "30 % lost"),
    *at_each("paper-late", "ratio", "the paper's protocol, nothing lost"),
    *at_each("paper-late-lossy", "ratio", "the paper's protocol, 30 % lost"),
    *at_each("evidence-line-relayed", "knows", "3 of 10 in a line see, 10 % lost: share that knows", least=1.0),
    *at_each("evidence-relayed", "knows", "on the hard graph", least=1.0),
    *at_each("evidence-relayed", "ratio", "error over the bound there"),
    *at_each("paper-line-relayed", "knows", "the paper's protocol in a line: share that knows"),
    *at_each("paper-relayed", "knows", "the paper's protocol on the hard graph"),
    *at_each("evidence-wrong", "ratio", "1 of 3 is 300 mm off: the others' error over their bound", most=WRONG),
    *at_each("evidence-wrong-10", "ratio", "1 of 10 is 300 mm off", most=WRONG),
    *at_each("paper-wrong", "mm", "1 of 3 is 300 mm off, the paper's protocol: the others' error"),
    *at_each("metropolis-wrong", "mm", "Metropolis averaging there"),
    *at_each("honest-3", "ratio", "3 robots, errors that stay: error over the bound", most=HONEST_COMPANY[3]),
    *at_each("honest-5", "ratio", "5 robots", most=HONEST_COMPANY[5]),
    *at_each("honest-10", "ratio", "10 robots", most=HONEST_COMPANY[10]),
    *at_each("honest-3", "nees", "3 robots, errors that stay: NEES", *NEES),
    *at_each("honest-5", "nees", "5 robots", *NEES),
    *at_each("honest-10", "nees", "10 robots", *NEES),
    *at_each("moving", "ratio", "target at 20 mm/s, 10 robots, 30 % lost: error over a central filter's", most=MOVING),
    *at_each("moving-often", "ratio", "ten messages an iteration", most=MOVING),
    *at_each("moving-fast", "ratio", "five iterations a sample", most=MOVING),
    *at_each("moving-3-wrong", "ratio", "3 robots, 1 of them 300 mm off: the others' error over theirs", most=WRONG),
)

CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    cases=tuple(CASES),
    quick={"draws": 1, "iterations": 20},
    measured_on="model",
    figures=FIGURES,
    explanation="""Robots around a ball share what their cameras measure, in virtual time; a seed is a batch of draws of
        their measurements and of what is lost, t counts iterations. The bound is that of Cramer and Rao: the error of
        a fusion that has all measurements at once. `evidence` is Aucamp's protocol and the one where none is named,
        the paper's is taken as it is written. NEES is the error squared in units of the stated covariance, 3 where it
        is honest.""",
)
