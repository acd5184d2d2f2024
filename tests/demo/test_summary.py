"""The scores of a run, from made-up states."""

import math

import pytest

from agent.demo.summary import History, first_below, reasons, score, settled, summarize
from agent.fleet_files import fleet_file
from agent.kernel.fleet_reader import load_fleet
from agent.kernel.messages import State

TRUTH = (0.76, 0.56, 0.07)


def state(t: int, error_m: float | None, **changes) -> State:
    x = None if error_m is None else (TRUTH[0] + error_m, TRUTH[1], TRUTH[2])
    fields = dict(
        fleet="tank", robot="r1", incarnation=1, seq=t, sent_ns=t, target="ball", knows="sees", t=t, posterior_m=x
    )
    return State(**{**fields, **changes})


def test_score_in_the_papers_terms() -> None:
    states = [state(t, 0.01 / (t + 1), acquired_t=3, measurements=t, prior_m=(0.77, 0.56, 0.07)) for t in range(20)]
    row = score(History(states), TRUTH)
    assert row["error_mm"] == pytest.approx(0.5)
    assert row["relative_error_percent"] == pytest.approx(100 * 0.0005 / math.dist((0, 0, 0), TRUTH))
    assert row["acquired_iteration"] == 3
    assert row["prior_rmse_mm"] == pytest.approx(10.0)
    assert row["error_axis_mm"] == pytest.approx([0.5, 0.0, 0.0])


def test_below_counts_only_from_the_last_excursion_on() -> None:
    errors = [0.02, 0.001, 0.02, 0.001, 0.001]
    assert first_below(History([state(t, e) for t, e in enumerate(errors)]), TRUTH) == 3
    assert first_below(History([state(0, 0.001), state(1, 0.02)]), TRUTH) is None


def test_reasons_name_the_robot() -> None:
    good = score(History([state(5, 0.001, acquired_t=1)]), TRUTH)
    bad = score(History([state(5, 0.02)]), TRUTH)
    nothing = score(History([]), TRUTH)
    assert reasons({"r1": good}) == []
    why = reasons({"r1": good, "r2": bad, "r3": nothing})
    assert any(w.startswith("r2: relative error 2.1") for w in why)
    assert "r2 never saw the target" in why
    assert "r3 has no estimate" in why


def test_settled_needs_views_patience_and_rest() -> None:
    def histories(last_view: int, moving: float) -> list[History]:
        return [
            History([state(t, 0.001 + moving * t, acquired_t=view if t >= view else None) for t in range(40)])
            for view in (3, last_view)
        ]

    assert settled(histories(5, 0.0), after_views=30, window=10, within_m=0.0015)
    assert not settled(histories(15, 0.0), after_views=30, window=10, within_m=0.0015)
    assert not settled(histories(5, 0.001), after_views=30, window=10, within_m=0.0015)
    assert not settled([*histories(5, 0.0), History([])], after_views=30, window=10, within_m=0.0015)


def test_the_verdict_is_over_all_targets() -> None:
    fleet = load_fleet(fleet_file("two_balls"))
    good = {"r1": History([state(5, 0.001, acquired_t=1)])}
    bad = {"r1": History([state(5, 0.02, acquired_t=1, target="buoy")])}
    truth = {"target_m": {"ball": TRUTH, "buoy": TRUTH}}
    summary = summarize(fleet, {"ball": good, "buoy": good}, truth, 1.0)
    assert summary["verdict"] == "pass"
    assert summary["agents"] == summary["targets"]["ball"]["agents"]
    summary = summarize(fleet, {"ball": good, "buoy": bad}, truth, 1.0)
    assert summary["verdict"] == "fail"
    assert summary["reasons"][0].startswith("buoy: r1: relative error 2.1")
