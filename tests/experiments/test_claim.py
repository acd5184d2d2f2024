"""How sure a figure is: intervals against what they promise, verdicts, and that every claim of the table can be run."""

import math

import msgspec
import numpy as np
import pytest
from scipy import stats

from agent.core.config import ConfigError
from agent.experiments.claim import (
    LEVEL,
    Figure,
    Measured,
    Quantile,
    Share,
    interval,
    measure,
    of_quantile,
    of_share,
    percentile,
    verdict,
)
from agent.experiments.registry import CLAIMS, ROOT, load, path_of
from tests.experiments import dice

INF = math.inf


def covered(draw, truth: float, trials: int = 400) -> float:
    """Share of the intervals of drawn data that hold the truth."""
    rng = np.random.default_rng(7)
    return sum(low <= truth <= high for low, high in (draw(rng) for _ in range(trials))) / trials


def test_the_interval_of_a_share_is_clopper_and_pearson_s() -> None:
    found = of_share(Share(20, 20), 100.0)
    assert found.value == found.high == 100.0 and found.low == pytest.approx(100.0 * 0.05 ** (1 / 20))
    assert covered(lambda rng: of_share(Share(int(rng.binomial(20, 0.9)), 20))[1:3], 0.9) >= LEVEL
    assert of_share(Share(0, 0)) == Measured(INF, -INF, INF, 0)


def test_the_interval_of_a_quantile_holds_it_as_often_as_it_says() -> None:
    """A bootstrap's does not: it knows no value beyond the largest."""

    def ordered(rng):
        return of_quantile(Quantile(rng.exponential(size=60).tolist(), 95.0))[1:3]

    def bootstrapped(rng):
        values = rng.exponential(size=20).tolist()
        return interval(percentile(values, 95.0), [percentile(rng.choice(values, 20), 95.0) for _ in range(200)], 20)

    assert covered(ordered, -math.log(0.05)) >= LEVEL - 0.03
    assert covered(bootstrapped, -math.log(0.05)) < 0.8
    assert of_quantile(Quantile([2.0, 1.0], 100.0))[:3] == (2.0, 2.0, INF), "the largest yet: the next may be larger"
    assert of_quantile(Quantile([2.0, 1.0], 0.0))[:3] == (1.0, -INF, 1.0)
    assert of_quantile(Quantile([1.0] * 58, 95.0)).high == INF, "of 58 nobody can say what 95 % keep"
    assert of_quantile(Quantile([1.0] * 59, 95.0)).high == 1.0
    assert of_quantile(Quantile([1.0, None, 2.0], 50.0)).value == 2.0
    assert of_quantile(Quantile([float(k) for k in range(1, 61)], 95.0)).value == 57.0


@pytest.mark.parametrize("skew", [0.0, 0.4])
@pytest.mark.parametrize("n", [2, 3, 5, 8, 20])
def test_the_interval_of_a_number_holds_it_as_often_as_it_says(n: int, skew: float) -> None:
    """Means of few seeds: normal, and log-normal with so large a sigma. No wider than Student's by much."""
    drawn = np.random.default_rng(0).integers(n, size=(300, n))
    widths, usual, errors = [], [], stats.t.ppf(0.95, n - 1)

    def mean(rng):
        values = rng.normal(size=n)
        values = np.exp(skew * values) if skew else values
        low, high = interval(float(values.mean()), values[drawn].mean(axis=1), n)
        widths.append(high - low)
        usual.append(2.0 * errors * values.std(ddof=1) / math.sqrt(n))
        return low, high

    assert covered(mean, math.exp(0.5 * skew**2) if skew else 0.0, 1000) >= LEVEL - 0.04
    assert 0.97 < np.mean(widths) / np.mean(usual) < 1.12


def test_a_number_of_seeds_that_never_differ_or_never_come() -> None:
    assert interval(3.0, [3.0] * 9, 4) == (-INF, INF) and interval(3.0, [3.0] * 9, 5) == (3.0, 3.0)
    assert interval(INF, [INF] * 9, 5) == (INF, INF) and interval(INF, [INF, 1.0, 2.0], 5) == (-INF, INF)
    low, high = interval(1.0, [0.0, 1.0, INF], 3)
    assert high == INF and -INF < low < 0.0


def test_the_bootstrap_draws_whole_seeds() -> None:
    """Rows of one seed are alike, so many rows do not make a figure surer."""
    claim = dice.CLAIM._replace(summary=lambda rows: {"mean": float(np.mean([row["eyes"] for row in rows["one"]]))})
    rng = np.random.default_rng(3)
    few = {seed: [{"eyes": value}] for seed, value in enumerate(rng.normal(3.5, 1.0, 20))}
    many = {seed: rows * 50 for seed, rows in few.items()}
    assert measure(claim, {"one": few})["mean"] == pytest.approx(measure(claim, {"one": many})["mean"])
    found = measure(claim, {"one": few})["mean"]
    assert found.n == 20 and found.high - found.low == pytest.approx(2 * 1.645 / math.sqrt(20), rel=0.35)
    alone = measure(claim, {"one": {0: few[0]}})["mean"]
    assert (alone.low, alone.high) == (-INF, INF), "one seed says nothing of the next"
    assert measure(claim._replace(exact=True), {"one": {0: few[0]}})["mean"].low == alone.value


@pytest.mark.parametrize(
    ("unit", "value", "seeds", "low", "high"),
    [("%", 100.0, 5, 54.9, 100.0), ("%", 0.0, 20, 0.0, 13.9), ("s", 0.0, 20, 0.0, INF), ("bytes", 233.0, 5, 233, 233)],
)
def test_all_or_nothing_in_each_seed_is_known_as_so_many_trials_tell_it(unit, value, seeds, low, high) -> None:
    claim = dice.CLAIM._replace(
        summary=lambda rows: {"mean": float(np.mean([row["x"] for row in rows["one"]]))},
        figures=(Figure("mean", "what all seeds have alike", unit),),
    )
    found = measure(claim, {"one": {seed: [{"x": value}] for seed in range(seeds)}})["mean"]
    assert (found.value, found.low, found.high) == pytest.approx((value, low, high), abs=0.1)


def test_a_ratio_of_two_cases_is_one_of_the_same_seeds() -> None:
    def ratio(rows):
        return {"mean": sum(r["x"] for r in rows["a"]) / sum(r["x"] for r in rows["b"])}

    rng = np.random.default_rng(1)
    worlds = rng.uniform(1.0, 10.0, 20)
    found = {
        "a": {k: [{"x": 2.0 * w}] for k, w in enumerate(worlds)},
        "b": {k: [{"x": w}] for k, w in enumerate(worlds)},
    }
    measured = measure(dice.CLAIM._replace(summary=ratio), found)["mean"]
    assert measured.low == pytest.approx(2.0) and measured.high == pytest.approx(2.0)


MOST, LEAST, BAND = Figure("x", "x", most=2.0), Figure("x", "x", least=2.0), Figure("x", "x", least=1.0, most=2.0)


@pytest.mark.parametrize(
    ("figure", "measured", "expected"),
    [
        (MOST, (1.0, 0.5, 1.5), "met"),
        (MOST, (1.0, 0.5, 2.5), "not shown"),
        (MOST, (3.0, 2.5, INF), "missed"),
        (MOST, (1.0, -INF, INF), "not shown"),
        (MOST, (INF, 1.0, INF), "not shown"),
        (MOST, (INF, INF, INF), "missed"),
        (LEAST, (3.0, 2.0, 4.0), "met"),
        (LEAST, (1.0, 0.5, 1.5), "missed"),
        (LEAST, (-INF, -INF, -INF), "missed"),
        (LEAST, (3.0, -INF, 4.0), "not shown"),
        (BAND, (1.5, 1.2, 1.8), "met"),
        (BAND, (0.79, 0.56, 1.0), "not shown"),
        (BAND, (0.5, 0.4, 0.9), "missed"),
        (BAND, (2.5, 2.1, 3.0), "missed"),
        (Figure("x", "x"), (1.0, 0.5, 1.5), ""),
    ],
)
def test_a_target_is_met_missed_or_not_shown(figure: Figure, measured: tuple, expected: str) -> None:
    assert verdict(figure, Measured(*measured, n=20)) == expected


@pytest.mark.parametrize("name", CLAIMS)
def test_a_claim_of_the_table_can_be_run_and_told(name: str) -> None:
    """What claim.py asks of each; that it measures what it says is a test of its own."""
    entry = CLAIMS[name]
    assert path_of(entry.module) is not None and all((ROOT / path).exists() for path in entry.also)
    claim = load(entry.module)
    settings = claim.settings()
    assert msgspec.convert(msgspec.to_builtins(settings), claim.settings) == settings, "they go to other processes"
    msgspec.convert(dict(claim.quick), claim.settings, strict=False)
    keys = [figure.key for figure in claim.figures]
    assert keys and len(set(keys)) == len(keys) and claim.cases and claim.explanation.strip()
    assert set(claim.by_default or ()) <= set(claim.cases) and claim.seeds >= 1
    assert callable(claim.run) and callable(claim.summary)


def test_a_figure_that_the_summary_does_not_have_is_no_target_met() -> None:
    claim = dice.CLAIM._replace(summary=lambda rows: {"tails": 0.5})
    with pytest.raises(ConfigError, match=r"the summary has no '\w+', of which CLAIM has a figure; it has tails"):
        measure(claim, {case: {0: [{"eyes": 1}]} for case in claim.cases})
