"""The definitions behind the orientation figures, on motions that a pencil can check."""

from __future__ import annotations

import numpy as np
import pytest

from agent.experiments.experiment import spread
from agent.experiments.orientation import LIMIT_S, SAMPLE_S, STAY_S, Track, for_good_s, score_push, score_step

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
