"""The orientation experiment in small: real firmware processes, the twin's water; and what counts as settled."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from agent.experiments.claim import NoSettings, Quantile, Share
from agent.experiments.orientation import (
    HOVER_S,
    LIMIT_S,
    MASS_SPREAD,
    PUSH,
    SAMPLE_S,
    STAY_S,
    STRANGE,
    Track,
    for_good_s,
    mass_scale_of,
    respond,
    run,
    score_push,
    score_step,
    summary,
)
from agent.process.command import Failed
from hw.twin.physics.tank import Plant


def children() -> set[str]:
    return set(Path(f"/proc/{os.getpid()}/task/{os.getpid()}/children").read_text().split())


def test_a_robot_is_pushed_and_sent_down():
    before = children()
    (row,) = run(3, "observer", NoSettings())
    assert children() == before
    assert 0.1 < row["recovery_s"] < 1.5 and 0.3 < row["settle_s"] < 1.5
    assert 0 < row["hover_depth_rms_mm"] < 1.0 and 0 < row["hover_tilt_rms_deg"] < 0.2
    assert row["push_tilt_deg"] > 5.0 and row["push_off_mm"] > 10.0, "the push was felt"


def test_thrusters_far_too_slow_for_the_law_are_seen_to_fail():
    track = respond("observer", Plant(lag_s=1.5), PUSH, 7)
    assert score_push(track, PUSH.goal_m, HOVER_S)["recovery_s"] is None


def test_a_law_that_the_firmware_does_not_have_is_told():
    with pytest.raises(Failed, match="did not arm"):
        respond("wish", Plant(), PUSH, 7)


def test_robots_differ_in_mass():
    scales = [mass_scale_of(seed) for seed in range(50)]
    assert 1 - MASS_SPREAD < min(scales) < 0.9 and 1.1 < max(scales) < 1 + MASS_SPREAD


def test_a_robot_that_never_recovers_is_slower_than_all_and_not_stable():
    fine = dict.fromkeys(("recovery_s", "settle_s", "hover_depth_rms_mm", "hover_tilt_rms_deg"), 0.5)
    fine |= {"push_tilt_deg": 9.0, "overshoot_mm": 3.0}
    never = fine | {"recovery_s": None}
    strange = [{"robot": name, **(never if k == 1 else fine)} for k, name in enumerate(STRANGE)]
    told = summary({"pi": [fine, never], "stability": strange})
    assert told["pi_push_p95_s"] == Quantile([0.5, None], 95.0) and told["pi_hover_mm"] == 0.5
    assert [told[f"stability_{name}"] for name in STRANGE] == [Share(1, 1), Share(0, 1), Share(1, 1), Share(1, 1)]


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


def test_a_robot_that_leaves_after_the_limit_never_settled():
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
