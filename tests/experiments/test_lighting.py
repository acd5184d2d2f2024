"""A small run of the experiment, its tables and figures; what lost messages leave burning."""

import math

import numpy as np
import pytest

from agent.experiments import lighting
from agent.experiments.dark_water import DarkWater, correlation, stand
from agent.experiments.lighting import after_loss, missed, scored, sets_for
from agent.experiments.veil_monte_carlo import smoothed


@pytest.fixture(scope="module")
def result() -> lighting.Result:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lighting, "LADDER_M", (1.25,))
        patch.setattr(lighting, "SIZES", (2,))
        patch.setattr(lighting, "model_check", lambda *_: MODEL)
        return lighting.run(lighting.Settings(seed=3, scenes=1, draws=4, waters=("harbour",)), lambda *_: None)


MODEL = {
    "veil_first_order": 0.01,
    "veil_all_orders": 0.1,
    "twin_veil_first_order": 0.01,
    "twin_veil_all_orders": 0.1,
    "ms_per_lamp": 8.0,
    "correlation": {"harbour": None},
}


def test_a_neighbours_lamp_is_worth_more_than_the_own_one(result: lighting.Result) -> None:
    of = {row["policy"]: row for row in result.cases if row["distance_m"] == 1.25}
    assert of["rule"]["accepted"] == 1.0
    assert of["own"]["sigma_mm"] is None or of["own"]["sigma_mm"] > 2 * of["rule"]["sigma_mm"]


def test_there_is_a_row_for_each_policy_and_one_with_losses(result: lighting.Result) -> None:
    fleets = [(row["policy"], row["loss"]) for row in result.cases if row["distance_m"] is None]
    assert sorted(fleets) == sorted(
        [("own", 0.0), ("all", 0.0), ("common", 0.0), ("rule", 0.0), ("rule", 0.3), ("optimum", 0.0)]
    )
    assert all(row["sweeps"] == 2 for row in result.cases if row["distance_m"] is None)


def test_it_can_be_shown(result: lighting.Result) -> None:
    assert lighting.table(result) is not None
    assert [name for name, _ in lighting.figures(result)] == ["sigma.png", "usable.png"]


def test_lost_messages_leave_a_lender_dark_and_a_sweeper_with_its_own_lamp() -> None:
    always = np.random.default_rng(1)
    assert after_loss("r1", frozenset(("r2", "r3")), 1.0, always) == {"r1"}
    assert after_loss("r1", frozenset(("r2", "r3")), 0.0, always) == {"r2", "r3"}
    assert after_loss("r1", frozenset(("r1",)), 1.0, always) == {"r1"}


def test_the_optimum_is_no_worse_than_the_rule_by_their_own_score() -> None:
    sea = DarkWater("harbour", 0)
    stands = {"r1": stand(1.5, 0.0), "r2": stand(0.7, 40.0), "r3": stand(0.9, -60.0)}
    score = scored(sea, stands)
    rule, best = (sets_for(policy, sea, stands, score) for policy in ("rule", "optimum"))
    for name in stands:
        assert score.of(name, best[name]).log_j >= score.of(name, rule[name]).log_j


def test_an_outlier_is_smoothed_away_and_what_is_known_well_stays() -> None:
    x = np.linspace(0, 1, 9)
    true = np.add.outer(x**2, x)
    drawn, error = true.copy(), np.full(true.shape, 0.02)
    drawn[4, 4] += 2.0
    error[4, 4] = 1.0
    assert np.abs(smoothed(drawn, error) - true).max() < 0.05


def test_correlation_needs_sweeps_that_have_a_sigma() -> None:
    rows = [{"sigma_mm": 2.0 * k, "log_j": -2.0 * math.log(k), "facing": False} for k in range(1, 12)]
    assert correlation(rows) == pytest.approx(-1.0)
    assert correlation([{**row, "sigma_mm": None} for row in rows]) is None


def test_what_is_missed_is_said(result: lighting.Result) -> None:
    assert not missed(result.cases, MODEL, 1)  # no verdict of one fleet
    slow = {**MODEL, "ms_per_lamp": 30.0, "twin_veil_first_order": 0.1}
    assert missed([], slow, 4) == ["twin_veil_first_order", "ms_per_lamp"]
    ladder = [
        {
            "water": "harbour",
            "robots": 3,
            "policy": policy,
            "loss": 0.0,
            "distance_m": 1.25,
            "sigma_mm": sigma,
            "accepted": 1.0,
        }
        for policy, sigma in (("own", 12.0), ("rule", 5.0))
    ]
    assert len(missed(ladder, MODEL, 4)) == 2
