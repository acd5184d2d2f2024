"""The following experiment in small: what is counted of a dive, and one that is dived."""

import json
import math

import numpy as np
import pytest

from agent.core.config import Body
from agent.experiments import following_dive as following_basin
from agent.experiments.experiment import write_result
from agent.experiments.following import Result, Shown, losses, row_of, share, table, verdicts
from agent.experiments.following import figures as drawings
from agent.experiments.following_dive import FLEET, Case, Draw, all_cases, reaches
from agent.experiments.navigation.pursuit import BODY_M, Wanderer
from agent.experiments.navigation.swimmers import Pillar, hides
from hw.twin.scene import generator

N, WATCHED = 100, 20
CASE = Case("share", FLEET, 0.0, 0.15)
KEYS = {"policy", "robots", "loss", "speed_m_s", "seen_by_one", "seen_by_two", "seen_each", "rms_mm", "nees"} | {
    "reacquire_p95_s",
    "reacquire_any_side_p95_s",
}


def drawn(**other) -> Draw:
    """Three robots that see it all the time, 10 mm off."""
    every, never = np.ones((N, 3), bool), np.zeros((N, 3), bool)
    robots = np.zeros((N, 3, 3))
    robots[:, :, 0] = 0.5, 1.2, 2.0
    draw = Draw(
        t_s=0.1 * np.arange(1, N + 1),
        target_m=np.zeros((N, 3)),
        robots=robots,
        sees=every.copy(),
        in_sight=every.copy(),
        in_reach=every.copy(),
        covered=never.copy(),
        landmarks=never.copy(),
        error_m=np.full((N, 3), 0.010),
        nees=np.full((N, 3), 3.0),
        watched=WATCHED,
        weeds=(),
    )
    return draw._replace(**other)


def test_shares_leave_out_what_a_covered_camera_would_have_seen() -> None:
    draw = drawn()
    draw.sees[40:60, 0] = False
    draw.covered[40:60, 0] = True
    draw.sees[60:68, 1:] = False
    assert share(draw) == {
        "seen_by_one": 1.0,
        "seen_by_two": pytest.approx(0.9),
        "seen_each": pytest.approx(1.0 - 16 / 220),
    }


def test_time_to_see_it_again_counts_from_when_it_is_in_sight() -> None:
    draw = drawn()
    draw.sees[30:50, 0] = False  # hidden until 45: seen 0.5 s after that
    draw.in_sight[30:45, 0] = False
    draw.sees[60:63, 1] = False  # not lost: three frames
    draw.sees[70:90, :] = False  # nobody sees it; one looks at landmarks until 80
    draw.landmarks[70:80, 2] = True
    found = sorted(losses(draw))
    assert [(round(one.seconds, 3), one.seen, one.by_others) for one in found] == [
        (0.5, True, True),
        (2.0, True, True),
        (2.0, True, True),
        (1.0, True, False),
    ]
    draw.sees[70:, 2] = False  # to the end: never
    row = row_of(CASE, [draw])
    assert row["losses"] == 3 and row["losses_alone"] == 1 and row["reacquire_alone_p95_s"] is None


def test_who_has_it_behind_is_asked_for_it_from_when_the_gimbal_reaches() -> None:
    draw = drawn()
    draw.sees[30:50, 0] = False
    draw.in_reach[30:48, 0] = False
    (again,), (any_side,) = losses(draw), losses(draw, any_side=True)
    assert (again.seconds, any_side.seconds) == (0.2, 2.0)
    row = row_of(CASE, [draw])
    assert (row["reacquire_p95_s"], row["reacquire_any_side_p95_s"]) == (0.2, 2.0)


def test_a_gimbal_reaches_what_is_ahead_and_not_what_touches_the_lens() -> None:
    body = Body(camera_m=(0.1, 0.0, 0.0), pan_limit_deg=(-90.0, 90.0))
    here = (1.0, 1.0, math.pi)
    assert reaches(body, here, (0.4, 1.0, 0.2)) and reaches(body, here, (0.89, 1.4, 0.2))
    assert not reaches(body, here, (1.2, 1.0, 0.2)) and not reaches(body, here, (0.91, 1.4, 0.2))
    assert not reaches(body, here, (0.85, 1.0, 0.2))


def test_bars_are_for_three_that_share() -> None:
    fine = row_of(CASE, [drawn()])
    assert all(verdict.met for verdict in verdicts([fine])) and fine["rms_mm"] == pytest.approx(10.0)
    lossy = {**row_of(CASE._replace(loss=0.3), [drawn(error_m=np.full((N, 3), 0.012))])}
    assert [verdict.met for verdict in verdicts([fine, lossy])][-1] is False
    assert not verdicts([{**fine, "policy": "moored"}, {**fine, "robots": 5}])
    unknown = row_of(CASE, [drawn(error_m=np.full((N, 3), np.nan), nees=np.full((N, 3), np.nan))])
    assert {verdict.bar.key for verdict in verdicts([unknown]) if not verdict.met} == {"rms_mm", "nees"}


def test_a_result_has_the_keys_that_are_promised(tmp_path) -> None:
    draws = {case: [drawn()] for case in (CASE, CASE._replace(policy="silent"), CASE._replace(robots=1))}
    result = Result(cases=[row_of(case, of) for case, of in draws.items()], shown=Shown(draws, True))
    write_result(result, tmp_path)
    told = json.loads((tmp_path / "result.json").read_text())
    assert set(told) == {"cases"} and all(set(row) >= KEYS for row in told["cases"])
    assert table(result).renderables and not result.failed
    assert {name for name, _ in drawings(result)} >= {"following_again.svg", "following_share_3_0_15.png"}


def test_cases_are_those_that_can_differ() -> None:
    cases = all_cases()
    assert len(cases) == len(set(cases)) and {case.robots for case in cases if case.policy == "share"} == {1, 2, 3, 5}
    assert not [case for case in cases if case.loss and (case.robots == 1 or case.policy != "share")]
    assert all_cases("moored", 3) == tuple(case for case in cases if case.policy == "moored")


def test_weeds_hide_and_nothing_swims_through_them() -> None:
    weed = Pillar(1.5, 1.0, 0.1)
    assert hides(weed, (1.0, 1.0), (2.0, 1.1, 0.2)) and not hides(weed, (1.0, 1.0), (1.4, 1.0, 0.2))
    for seed in range(3):
        pillars = following_basin.weeds(seed)
        wanderer = Wanderer(generator(seed, "follow"), 0.2, 40.0, pillars)
        for k in range(400):
            x, y, _ = wanderer.at(10**18 + k * 100_000_000)
            assert all(math.hypot(x - p.x_m, y - p.y_m) > p.radius_m + 0.9 * BODY_M for p in pillars)
