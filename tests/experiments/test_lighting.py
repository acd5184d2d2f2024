"""Policies, what lost messages leave burning, and what the claims on light make of their rows."""

import numpy as np
import pytest

from agent.experiments.claim import Quantile, Share
from agent.experiments.dark_water import DarkWater, stand
from agent.experiments.lighting import NEIGHBOURS, Sweeps, correlation, ratio, scored, sets_for, summary
from tests.bench.light import bench_night
from tests.studies.veil import claim as veil
from tests.studies.veil.tables import smoothed


def test_a_neighbours_lamp_is_worth_more_than_the_own_one() -> None:
    sea = DarkWater("harbour", 3)
    sea.prepare()
    stands = {"r1": stand(1.25, 0.0), **{name: stand(*place) for name, *place in NEIGHBOURS}}
    sweeps = Sweeps(sea, stands, 6, 0)
    own, rule = (sweeps.of("r1", sweeps.by(policy)["r1"]) for policy in ("own", "rule"))
    assert rule.accepted == 1.0 and rule.sigma_mm is not None
    assert own.sigma_mm is None or own.sigma_mm > 2 * rule.sigma_mm
    assert len(sweeps.logs()) == (1 if own.sigma_mm is None else 2)


def test_the_optimum_is_no_worse_than_the_rule_by_their_own_score() -> None:
    sea = DarkWater("harbour", 0)
    stands = {"r1": stand(1.5, 0.0), "r2": stand(0.7, 40.0), "r3": stand(0.9, -60.0)}
    score = scored(sea, stands)
    rule, best = (sets_for(policy, sea, stands, score) for policy in ("rule", "optimum"))
    for name in stands:
        assert score(name, best[name]).log_j >= score(name, rule[name]).log_j


def test_an_outlier_is_smoothed_away_and_what_is_known_well_stays() -> None:
    x = np.linspace(0, 1, 9)
    true = np.add.outer(x**2, x)
    drawn, error = true.copy(), np.full(true.shape, 0.02)
    drawn[4, 4] += 2.0
    error[4, 4] = 1.0
    assert np.abs(smoothed(drawn, error) - true).max() < 0.05


def world(own_mm: float | None, rule_mm: float | None, usable: dict[str, int]) -> dict:
    log = [[10.0 - k, 1.0 + 0.5 * k] for k in range(4)]
    counts = {size: {**dict.fromkeys(("own", "rule", "optimum"), 1), "of": 2} for size in "23"}
    row = {"own_mm": own_mm, "rule_mm": rule_mm, "times_own": ratio(rule_mm, own_mm), "farther": 2.0, "logs": log}
    return {**row, "usable": {**counts, "5": usable}}


def test_a_robot_without_a_peak_by_its_own_lamp_has_all_to_gain() -> None:
    worlds = [
        world(None, 4.0, {"own": 2, "rule": 4, "optimum": 5, "of": 5}),
        world(20.0, 5.0, {"own": 5, "rule": 4, "optimum": 4, "of": 5}),
        world(20.0, None, {"own": 0, "rule": 0, "optimum": 1, "of": 5}),
    ]
    found = summary({"harbour": worlds})
    assert found["harbour_times_own"] == Quantile([0.0, 0.25, None], 50.0)
    assert found["harbour_rule_usable"] == Share(8, 15)
    assert found["harbour_below"] == pytest.approx(100.0 * 2 / 15)
    assert found["harbour_gain"] == 0.0  # of two and three robots; of five it is more
    assert found["harbour_correlation"] == pytest.approx(-1.0)
    assert correlation(worlds[0]["logs"]) is None


def test_places_that_are_too_far_off_are_counted() -> None:
    row = {"kernel_first": -0.03, "kernel_every": 0.1, "twin_first": 0.0, "twin_every": -0.31}
    found = veil.summary({"bay": [row], "coastal": [dict.fromkeys(row, 0.01)]})
    assert found["kernel_first"] == Share(1, 2) and found["twin_first"] == Share(2, 2)
    assert found["twin_every_worst"] == Quantile([31.0, 1.0], 100.0)


def test_a_dive_in_which_a_robot_knows_nothing_is_not_right() -> None:
    robot = {
        "doubted": False,
        "nees": 3.0,
        "nis": None,
        "epochs": 0,
        "first_s": 5.0,
        "kept": 3,
        "by_lent": 3,
        "rejected": 1,
    }
    blind = {**robot, "doubted": True, "nees": None, "epochs": 1, "first_s": None, "kept": 0, "by_lent": 0}
    right = {"settled_s": 90.0, "worst_percent": 0.2, "robots": [robot, robot]}
    lost = {"settled_s": None, "worst_percent": None, "robots": [robot, blind]}
    found = bench_night.summary({"night": [right, lost]})
    assert found["night_right"] == Share(1, 2) and found["night_steady"] == Share(3, 4)
    assert found["night_doubted"] == Share(1, 2)
    assert found["night_seen"] == Quantile([5.0, None], 50.0)
    assert found["night_nees"] == 3.0 and found["night_nis"] is None
