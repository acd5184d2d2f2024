"""The orientation experiment in small: real firmware processes, the twin's water, a result to read."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from agent.experiments.experiment import spread, write_figures, write_result
from agent.experiments.orientation import (
    HOVER_S,
    LIMIT_S,
    MASS_SPREAD,
    PUSH,
    SAMPLE_S,
    STAY_S,
    Case,
    Settings,
    Track,
    controllers_table,
    figures,
    for_good_s,
    groups,
    missed,
    respond,
    run,
    score_push,
    score_step,
    stability_table,
    table,
)
from agent.process.command import Failed


def children() -> set[str]:
    return set(Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split())


def test_every_law_meets_the_same_robots():
    first, second = (list(groups(3, 12, law, lag_s)) for law, lag_s in (("observer", 0.10), ("pi", 0.15)))
    assert [len(g.cases) for g in first] == [5, 5, 2]
    assert len({g.world for g in first}) == 3
    assert [(g.world, [c.mass_scale for c in g.cases]) for g in first] == [
        (g.world, [c.mass_scale for c in g.cases]) for g in second
    ]
    scales = sorted(c.mass_scale for g in first for c in g.cases)
    assert scales[0] == pytest.approx(1 - MASS_SPREAD, abs=0.02) and scales[-1] == pytest.approx(
        1 + MASS_SPREAD, abs=0.02
    )
    assert {g.world for g in groups(4, 12, "pi", 0.10)}.isdisjoint(g.world for g in first)


@pytest.mark.slow
def test_a_small_experiment_from_end_to_end(tmp_path):
    steps = []
    before = children()
    settings = Settings(seeds=1, laws=("observer",), lags_s=(0.10,))
    result = run(settings, lambda done, total: steps.append((done, total)))
    assert children() == before
    assert steps == [(k, 5) for k in range(6)]  # one group, and mass by delay
    observer = result.controllers["observer"]
    assert observer["push_recovery_s"]["never"] == observer["step_settle_s"]["never"] == 0
    assert 0.1 < observer["push_recovery_s"]["median"] < 1.5
    assert 0.3 < observer["step_settle_s"]["median"] < 1.5
    assert 0 < observer["hover_depth_rms_mm"] < 1.0 and 0 < observer["hover_tilt_rms_deg"] < 0.2
    assert all(line["stable"] for line in result.stability)
    assert len(result.cases) == 1 + 4
    for row in result.cases:
        assert row["failsafe"] == 0 and not row["disarmed"]
        assert row["push_tilt_deg"] > 5.0 and row["push_off_mm"] > 10.0, "the push was felt"
        assert row["deepest_m"] > 0.40, "the step was gone"
    assert controllers_table(result).row_count == 1 and stability_table(result).row_count == 4
    assert any(str(line).startswith("twin, firmware under") for line in table(result).renderables)
    write_result(result, tmp_path)
    assert json.loads((tmp_path / "result.json").read_text()) == result.as_json()
    write_figures(figures(result), tmp_path)
    for name in ("orientation_push", "orientation_step"):
        assert (tmp_path / f"{name}.svg").read_text().count("T4") == 1
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000


def test_thrusters_far_too_slow_for_the_law_are_seen_to_fail(tmp_path):
    (response,) = respond([Case("observer", 0, 1.5, 1.0)], PUSH, 7, tmp_path, sys.executable)
    scored = score_push(response.track, PUSH.goal_m, HOVER_S)
    assert scored["recovery_s"] is None


def test_a_law_that_the_firmware_does_not_have_is_told(tmp_path):
    with pytest.raises(Failed, match="did not arm"):
        respond([Case("wish", 0, 0.1, 1.0)], PUSH, 7, tmp_path, sys.executable)


def test_missed_targets_are_named():
    good = {
        "push_recovery_s": {"median": 0.9, "p95": 1.2, "never": 0},
        "step_settle_s": {"median": 0.8, "p95": 1.0, "never": 0},
        "hover_depth_rms_mm": 0.2,
        "hover_tilt_rms_deg": 0.1,
    }
    assert missed(good) == []
    bad = good | {"hover_tilt_rms_deg": 0.31, "push_recovery_s": {"median": 0.9, "p95": None, "never": 2}}
    assert missed(bad) == ["push_recovery_s p95 never, target 1.5", "hover_tilt_rms_deg 0.31, target 0.2"]


# --- orientation settling ---
# The definitions behind the orientation figures, on motions that a pencil can check.

WATCH = round((LIMIT_S + STAY_S) / SAMPLE_S)


def track(depth_m=None, roll_deg=None, before_s=1.0):
    """A robot at 0.30 m that follows the functions of time it is given."""
    n = round(before_s / SAMPLE_S) + WATCH
    t_s = SAMPLE_S * (np.arange(n) + 1) - before_s
    still = np.zeros(n)
    depth = np.full(n, 0.30) if depth_m is None else np.vectorize(depth_m)(t_s)
    return Track(t_s, depth, still if roll_deg is None else np.vectorize(roll_deg)(t_s), still)


def test_good_from_the_first_sample_is_zero_and_later_counts_from_there():
    good = np.ones(WATCH, bool)
    assert for_good_s(good) == 0.0
    good[:120] = False
    assert for_good_s(good) == pytest.approx(1.2)


def test_passing_through_the_band_is_not_settling():
    good = np.ones(WATCH, bool)
    good[:30] = False
    good[80:90] = False
    assert for_good_s(good) == pytest.approx(0.9)


def test_who_leaves_after_the_limit_never_settled():
    good = np.ones(WATCH, bool)
    good[round(LIMIT_S / SAMPLE_S) + 20] = False
    assert for_good_s(good) is None


def test_too_short_a_watch_is_no_answer():
    with pytest.raises(ValueError, match="are needed"):
        for_good_s(np.ones(WATCH - 2, bool))


def test_recovery_waits_for_depth_and_for_level():
    deep = track(depth_m=lambda t: 0.33 if 0 < t <= 0.5 else 0.30)
    assert score_push(deep, 0.30, 0.5)["recovery_s"] == pytest.approx(0.5, abs=0.011)
    both = deep._replace(roll_deg=np.where((deep.t_s > -0.2) & (deep.t_s <= 0.8), -9.0, 0.0))
    scored = score_push(both, 0.30, 0.5)
    assert scored["recovery_s"] == pytest.approx(0.8, abs=0.011)
    assert scored["push_tilt_deg"] == 9.0
    assert scored["push_off_mm"] == pytest.approx(30.0)


def test_hover_is_judged_before_the_push_alone():
    scored = score_push(track(depth_m=lambda t: 0.302 if t < -0.3 else 0.35), 0.30, 0.5)
    assert scored["hover_depth_rms_mm"] == pytest.approx(2.0)
    assert scored["recovery_s"] is None


@pytest.mark.parametrize(("start_m", "goal_m"), [(0.22, 0.41), (0.41, 0.22)])
def test_step_settles_and_overshoots_in_either_direction(start_m, goal_m):
    towards = np.sign(goal_m - start_m)

    def depth_m(t):
        return start_m if t < 0.4 else goal_m + 0.015 * towards if t < 0.9 else goal_m - 0.005 * towards

    scored = score_step(track(depth_m=depth_m), start_m, goal_m)
    assert scored["settle_s"] == pytest.approx(0.9, abs=0.011)
    assert scored["overshoot_mm"] == pytest.approx(15.0)


def test_spread_counts_the_never_as_slower_than_all():
    assert spread([0.1 * k for k in range(1, 21)]) == {
        "median": pytest.approx(1.05),
        "p95": pytest.approx(1.9),
        "never": 0,
    }
    assert spread([0.5] * 18 + [None] * 2) == {"median": 0.5, "p95": None, "never": 2}
    assert spread([0.5, None]) == {"median": None, "p95": None, "never": 1}
