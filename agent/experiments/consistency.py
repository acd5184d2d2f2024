"""Is a measurement as far from the truth as its covariance says?

The normalised error squared e^T C^-1 e has the mean 3 where the covariance is honest, is larger where it boasts,
smaller where it is timid. Robots of many worlds measure a ball (`ball_measurements`), with every cue.
"""

from __future__ import annotations

import itertools
from collections import Counter
from typing import get_args

import msgspec
import numpy as np
from rich.console import Group
from rich.table import Table

from agent.core.config import Cues
from agent.experiments.ball_measurements import RANGE_M, ball_measurements
from agent.experiments.experiment import ExperimentResult, Row
from agent.process.command import Progress, step_by_step

PLACES = 25  # measurements of one robot; the next has another lens, calibration and ball
RANGES_M = (RANGE_M[0], 0.40, 0.60, 0.90, RANGE_M[1])
ENOUGH = 1000  # measurements: of 40 robots, whose errors of calibration stay
EXPECTED = (2.5, 3.5)  # of the mean, for three degrees of freedom


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    seed: int = 0  # the first world; the others follow it
    count: int = ENOUGH  # measurements


class Result(ExperimentResult, frozen=True, kw_only=True):
    """A row in `cases` for each of the cues and each band of range, and all measurements."""

    schema: int = 1
    source: str = "twin"
    seed: int
    count: int
    expected: tuple[float, float] = EXPECTED
    cases: list[Row]
    measurements: list[Row]

    @property
    def honest(self) -> bool | None:
        """Whether the mean with both cues over all ranges lies where it should; None: too few to tell."""
        if self.count < ENOUGH:
            return None
        whole = next(case for case in reversed(self.cases) if case["cues"] == "both")
        return whole["nees"] is not None and self.expected[0] <= whole["nees"] <= self.expected[1]

    @property
    def failed(self) -> bool:
        return self.honest is False


def run(settings: Settings, progress: Progress) -> Result:
    """Measure in worlds from the seed on; progress counts measurements."""
    measured: list[Row] = []
    step = step_by_step(progress, settings.count)
    for world, first in enumerate(range(0, settings.count, PLACES)):
        for row in ball_measurements(1000 * settings.seed + world, min(PLACES, settings.count - first)):
            measured.append(row)
            step()
    cases = [summary(measured, cue, low, high) for cue in get_args(Cues) for low, high in bands()]
    return Result(seed=settings.seed, count=settings.count, cases=cases, measurements=measured)


def bands() -> list[tuple[float, float]]:
    """The bands of range, m, the last of them from end to end."""
    return [*itertools.pairwise(RANGES_M), (RANGES_M[0], RANGES_M[-1])]


def summary(measurements: list[Row], cue: str, low_m: float, high_m: float) -> Row:
    """All measurements with one cue in one band of range."""
    within = [one for one in measurements if low_m <= one["distance_m"] <= high_m]
    good = [one[cue] for one in within if "nees" in one[cue]]
    nees = np.array([one["nees"] for one in good])
    figures: Row = {"cues": cue, "range_m": [low_m, high_m], "count": len(within), "measured": len(good)}
    if not good:
        return {**figures, "nees": None, "nees_median": None, "error_rms_mm": None, "sigma_mm": None}
    return {
        **figures,
        "nees": float(nees.mean()),
        "nees_median": float(np.median(nees)),  # 2.37 for three degrees of freedom
        "error_rms_mm": float(np.sqrt(np.mean([one["error_mm"] ** 2 for one in good]))),
        "sigma_mm": float(np.sqrt(np.mean([one["sigma_mm"] ** 2 for one in good]))),
    }


# --- tables ---


def table(result: Result) -> Group:
    """Cases, refusals, and whether the mean is where it should be."""
    reasons = refusals(result.measurements).most_common()
    low, high = result.expected
    return Group(
        cases_table(result.cases),
        *(f"no measurement, {times} times: {reason}" for reason, times in reasons),
        *([f"missed: the mean with both cues is not within {low:g} to {high:g}"] if result.failed else []),
        *([f"no verdict: the target is for {ENOUGH} measurements"] if result.honest is None else []),
    )


def refusals(measurements: list[Row]) -> Counter[str]:
    """Why there was no measurement, numbers left out so that like counts with like."""
    reasons = (one["both"]["refused"] for one in measurements if "refused" in one["both"])
    return Counter("".join("#" if c.isdigit() else c for c in reason) for reason in reasons)


def cases_table(cases: list[Row]) -> Table:
    """A line for each of the cues and each band of range."""
    shown = Table(title="normalised error squared: 3 is honest, more is boastful, less is timid")
    for column in ("cues", "range m", "measured", "mean", "median (2.37)", "rms error mm", "stated sigma mm"):
        shown.add_column(column, justify="left" if column == "cues" else "right")
    for case in cases:
        low, high = case["range_m"]
        figures = (case[key] for key in ("nees", "nees_median", "error_rms_mm", "sigma_mm"))
        shown.add_row(
            case["cues"],
            f"{low:g} to {high:g}",
            f"{case['measured']} of {case['count']}",
            *("-" if value is None else f"{value:.2f}" for value in figures),
        )
    return shown
