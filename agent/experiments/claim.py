"""A claim: what is said of Aucamp, how it is measured, and what has to come out. Experiments and benches are claims.

A claim is one small module with a constant CLAIM, and a row in registry.py; docs/experiments.md has one.
`run` is pure: the same seed gives the same rows, in any process; it draws all chance from its seed. A bench measures
the machine that it runs on, so its rows are ratios of two ways taken in one run, and its seeds are repetitions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import msgspec
import numpy as np

from agent.core.config import ConfigError

Row = dict[str, Any]  # what JSON holds: numbers, texts, lists and dicts of them, None; no infinity, no NaN
Rows = Mapping[str, Sequence[Row]]  # of each case that was run, the rows of all its seeds in order

MeasuredOn = Literal["twin", "model", "real pictures", "chip model", "processes", "outside judge", "this machine"]
Verdict = Literal["met", "missed", "not shown", ""]  # "": there is no target


class Share(NamedTuple):
    """How many of how many, each a trial of its own; its interval is that of a binomial, and not a bootstrap's.

    Many frames or robots of one seed are alike: a share of them is told as a number, which is as sure as seeds are.
    """

    hits: int
    of: int


class Quantile(NamedTuple):
    """The smallest value that at least `percent` of the seeds keep; one value a seed, None: never. Of 0 and of 100 it
    is the least and the largest that was seen, and nobody knows how far the next seed goes beyond.

    Its interval is made of the values in their order and supposes nothing of how they are spread. A bootstrap would be
    too sure: it knows no value beyond the largest one seen. That 95 % keep a limit takes 59 seeds to show, all of them
    within it.
    """

    values: Sequence[float | None]
    percent: float


Value = float | Share | Quantile | None  # None: never, which misses any target; NaN: nothing there to measure


class Figure(NamedTuple):
    """One number that a claim states, and where it has to lie. A figure without limits is told and not judged."""

    key: str  # in what `summary` returns
    words: str
    unit: str = ""  # "%": of a Share, told in hundredths
    least: float | None = None
    most: float | None = None
    paper: str = ""  # what the paper says of it

    @property
    def target(self) -> str:
        """As tables show it."""
        if self.least is None:
            return "" if self.most is None else f"<= {self.most:g}"
        return f">= {self.least:g}" if self.most is None else f"{self.least:g} to {self.most:g}"


class NoSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Of a claim that has nothing to choose but seeds and cases."""


class Claim(NamedTuple):
    """See the head of this file. Functions are those of a module: they go to other processes by name."""

    run: Callable[[int, str, Any], list[Row]]  # seed, case, settings
    summary: Callable[[Rows], dict[str, Value]]  # of the cases that were run; a figure of another case is left out
    figures: tuple[Figure, ...]
    explanation: str  # what the figures mean, in about three sentences; stands on the claim's page
    measured_on: MeasuredOn
    settings: type[msgspec.Struct] = NoSettings
    cases: tuple[str, ...] = ("all",)  # what --only chooses from
    by_default: tuple[str, ...] | None = None  # the cases that run without --only; None: all
    quick: Mapping[str, Any] = {}  # settings that --quick changes
    seeds: int = 20  # if --seeds is not given
    alone: bool = False  # it times the machine, or takes ports: nothing runs beside it
    exact: bool = False  # no chance in it: one seed says all, and the interval is the figure


# --- how well a figure is known ---

LEVEL = 0.90
RESAMPLES = 1000


class Measured(NamedTuple):
    """A figure's value, its interval of LEVEL, and n: seeds, or the trials of a share.

    An infinite end: where the figure may be is not known on that side, or it is never reached. `value` is infinite
    where it is never reached.
    """

    value: float
    low: float
    high: float
    n: int


UNKNOWN = Measured(math.inf, -math.inf, math.inf, 0)  # nothing was there to measure, which shows nothing


def measure(claim: Claim, found: Mapping[str, Mapping[int, Sequence[Row]]]) -> dict[str, Measured]:
    """All figures of the rows by case and seed. The bootstrap draws whole seeds, the same ones for all cases, so that a
    ratio of two cases is one of pairs. Raises ConfigError where all cases were run and a figure is not among what they
    came to: one that nobody judges would be taken for met."""
    seeds = sorted(set[int]().union(*(by_seed for by_seed in found.values())))

    def told(chosen: Sequence[int]) -> dict[str, Value]:
        pooled = {case: [row for seed in chosen for row in rows.get(seed, ())] for case, rows in found.items()}
        return claim.summary(pooled)

    values = told(seeds)
    lacks = [figure.key for figure in claim.figures if figure.key not in values]
    if lacks and (len(lacks) == len(claim.figures) or found.keys() >= set(claim.cases)):
        raise ConfigError(f"the summary has no {lacks[0]!r}, of which CLAIM has a figure; it has {', '.join(values)}")
    numbers = [value for value in values.values() if not isinstance(value, Share | Quantile)]
    chance = np.random.default_rng(0)
    again = range(RESAMPLES if numbers and len(seeds) > 1 and not claim.exact else 0)
    resamples = [told([seeds[k] for k in chance.integers(len(seeds), size=len(seeds))]) for _ in again]
    measured = {}
    for figure in claim.figures:
        if figure.key not in values:
            continue
        value = values[figure.key]
        if isinstance(value, Share):
            measured[figure.key] = of_share(value, 100.0 if figure.unit == "%" else 1.0)
            continue
        if isinstance(value, Quantile):
            measured[figure.key] = of_quantile(value)
            continue
        if value is not None and math.isnan(value):
            measured[figure.key] = UNKNOWN
            continue
        one = as_number(value, figure)
        drawn = [as_number(each[figure.key], figure) for each in resamples]
        low, high = (one, one) if claim.exact else interval(one, drawn, len(seeds), figure.unit)
        measured[figure.key] = Measured(one, low, high, len(seeds))
    return measured


def interval(value: float, resamples: Sequence[float], n: int, unit: str = "") -> tuple[float, float]:
    """Of a number that n seeds gave, by a bootstrap of them. Without any resample, nothing is known.

    Few seeds are drawn from themselves with too little spread, by sqrt((n - 1) / n), and a normal quantile is too
    short for them. So each end is the farther one of two: that of Student's t with the bootstrap's standard error,
    which for a mean is the usual interval, and the bootstrap's percentile, stretched as much, which follows a skew.
    """
    if not len(resamples):
        return -math.inf, math.inf
    from scipy.stats import norm, t  # here, for it takes a second

    tail = 0.5 * (1.0 - LEVEL)
    ordered = np.sort(resamples)  # not interpolated: some may be infinite
    last = len(ordered) - 1
    if math.isclose(ordered[0], ordered[last], rel_tol=1e-9):
        return _alike(value, n, unit)
    if math.isinf(value):
        return -math.inf, math.inf
    low, high = float(ordered[math.floor(tail * last)]), float(ordered[math.ceil((1.0 - tail) * last)])
    errors = math.sqrt(n / (n - 1)) * float(t.ppf(1.0 - tail, n - 1))
    off, wider = errors * float(np.std(ordered[np.isfinite(ordered)])), errors / float(norm.ppf(1.0 - tail))
    return value - max(wider * (value - low), off), value + max(wider * (high - value), off)


def _alike(value: float, n: int, unit: str) -> tuple[float, float]:
    """Of a number in which no seed differs. All or nothing of a share is known as n trials without a miss tell it, and
    of what never happened nobody knows how much it is; another number is known as well as the seeds' median is."""
    if unit == "%" and value in (0.0, 100.0):
        return of_share(Share(n if value else 0, n), 100.0)[1:3]
    if value == 0.0:
        return 0.0, math.inf
    return of_quantile(Quantile([value] * n, 50.0))[1:3]


def of_share(share: Share, scale: float = 1.0) -> Measured:
    """Clopper and Pearson's interval."""
    if not share.of:
        return UNKNOWN
    from scipy.stats import binomtest  # here, for it takes a second

    ends = binomtest(share.hits, share.of).proportion_ci(LEVEL, "exact")
    return Measured(scale * share.hits / share.of, scale * float(ends.low), scale * float(ends.high), share.of)


def of_quantile(quantile: Quantile) -> Measured:
    """By order statistics: how many of n values lie below a quantile is binomial."""
    ordered = in_order(quantile.values)
    n, share = len(ordered), 1e-2 * quantile.percent
    if not n:
        return UNKNOWN
    from scipy.stats import binom

    tail = 0.5 * (1.0 - LEVEL)
    low, high = round(binom.ppf(tail, n, share)), round(binom.ppf(1.0 - tail, n, share)) + 1
    value = kept_by(ordered, quantile.percent)
    return Measured(value, ordered[low - 1] if low else -math.inf, ordered[high - 1] if high <= n else math.inf, n)


def as_number(value: Value, figure: Figure) -> float:
    """Never is on the wrong side of every limit. Raises TypeError for a figure that is of two kinds by turns."""
    if isinstance(value, Share | Quantile):
        raise TypeError(f"{figure.key}: a figure is a share, a quantile or a number, whichever seeds are drawn")
    if value is None or math.isnan(value):
        return -math.inf if figure.most is None and figure.least is not None else math.inf
    return float(value)


def verdict(figure: Figure, measured: Measured) -> Verdict:
    """Met: the whole interval keeps the limits. Missed: none of it does. Else it is not shown."""
    if figure.least is None and figure.most is None:
        return ""
    least = -math.inf if figure.least is None else figure.least
    most = math.inf if figure.most is None else figure.most
    if math.isinf(measured.value):
        return "missed" if math.isinf(measured.low) and measured.low == measured.high else "not shown"
    if least <= measured.low and measured.high <= most and math.isfinite(measured.low + measured.high):
        return "met"
    return "missed" if measured.high < least or measured.low > most else "not shown"


# --- numbers of cases, of which some never come to an end ---


def rms(values: Sequence[float]) -> float | None:
    """Root mean square; None of nothing, and where one is infinite."""
    found = math.sqrt(float(np.mean(np.square(values)))) if len(values) else math.nan
    return found if math.isfinite(found) else None


def percentile(values: Sequence[float | None], percent: float) -> float | None:
    """Of many values a seed: the smallest that at least so many percent keep. None: that many never came; of nothing.

    Of one value a seed take Quantile.
    """
    if not len(values):
        return None
    found = kept_by(in_order(values), percent)
    return found if math.isfinite(found) else None


def in_order(values: Sequence[float | None]) -> list[float]:
    """None, which is never, comes last."""
    return sorted(math.inf if value is None else value for value in values)


def kept_by(ordered: Sequence[float], percent: float) -> float:
    """The smallest value that at least so many percent keep."""
    return ordered[max(math.ceil(percent * len(ordered) / 100.0) - 1, 0)]
