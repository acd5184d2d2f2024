"""What is counted of a dive that follows a target, and how dives add up."""

import math

import numpy as np
import pytest

from agent.core.config import Body
from agent.experiments import following_dive
from agent.experiments.claim import measure, verdict
from agent.experiments.following import CASES, CLAIM, figures_of, losses, row_of, summary
from agent.experiments.following_dive import BODY_M, Draw, Wanderer, reaches
from agent.experiments.navigation.swimmers import Pillar, hides
from hw.twin.scene import generator

N, WATCHED = 100, 20
CASE = CASES["share-3"]


def drawn(**other) -> Draw:
    """Three robots that see it all the time, 10 mm off."""
    every, never = np.ones((N, 3), bool), np.zeros((N, 3), bool)
    draw = Draw(
        t_s=0.1 * np.arange(1, N + 1),
        sees=every.copy(),
        in_sight=every.copy(),
        in_reach=every.copy(),
        covered=never.copy(),
        landmarks=never.copy(),
        error_m=np.full((N, 3), 0.010),
        nees=np.full((N, 3), 3.0),
        first=0,
        watched=WATCHED,
        least_m=0.7,
    )
    return draw._replace(**other)


def figures(draw: Draw) -> dict:
    return figures_of([row_of(CASE, draw)])


def test_shares_leave_out_what_a_covered_camera_would_have_seen() -> None:
    draw = drawn()
    draw.sees[40:60, 0] = False
    draw.covered[40:60, 0] = True
    draw.sees[60:68, 1:] = False
    draw.error_m[:WATCHED] = 0.1
    found = figures(draw)
    assert found["least"] == pytest.approx(90.0), "of robot 2 and 3"
    assert found["rms_mm"] == pytest.approx(10.0) and found["whole_rms_mm"] > 40.0
    assert [found[key] for key in ("by_one", "by_two", "each")] == pytest.approx([100.0, 90.0, 100.0 * (1 - 16 / 220)])


def test_time_to_see_it_again_counts_from_when_it_is_in_sight() -> None:
    draw = drawn()
    draw.sees[30:50, 0] = False  # hidden until 45: seen 0.5 s after that
    draw.in_sight[30:45, 0] = False
    draw.sees[60:63, 1] = False  # not lost: three frames
    draw.sees[70:90, :] = False  # nobody sees it; one looks at landmarks until 80
    draw.landmarks[70:80, 2] = True
    found = sorted(losses(draw))
    assert [(one.seconds, one.by_others) for one in found] == [(0.5, True), (2.0, True), (2.0, True), (1.0, False)]
    draw.sees[70:, 2] = False  # to the end: never
    row = row_of(CASE, draw)
    assert row["again_s"] == [0.5, 2.0, 2.0] and row["again_alone_s"] == [None]
    assert figures(draw)["again_alone_s"] is None


def test_no_loss_of_it_shows_nothing_of_how_soon_it_is_seen_again() -> None:
    key = "share-3_0.15_again_alone_s"
    figure = next(figure for figure in CLAIM.figures if figure.key == key)
    lost = drawn()
    lost.sees[70:85, :] = lost.in_sight[70:80, :] = False
    never, once = ([{"speed_m_s": 0.15, **row_of(CASE, draw)}] for draw in (drawn(), lost))
    assert verdict(figure, measure(CLAIM, {"share-3": {0: never, 1: never}})[key]) == "not shown"
    found = measure(CLAIM, {"share-3": {0: never, 1: once}})[key]
    assert found.value == 0.5 and verdict(figure, found) == "not shown", "one seed may be drawn without a loss"
    assert verdict(figure, measure(CLAIM, {"share-3": dict.fromkeys(range(5), once)})[key]) == "met"


def test_a_robot_that_has_it_behind_is_asked_for_it_from_when_the_gimbal_reaches() -> None:
    draw = drawn()
    draw.sees[30:50, 0] = False
    draw.in_reach[30:48, 0] = False
    (again,), (any_side,) = losses(draw), losses(draw, any_side=True)
    assert (again.seconds, any_side.seconds) == (0.2, 2.0)
    assert (figures(draw)["again_s"], figures(draw)["again_any_side_s"]) == (0.2, 2.0)


def test_a_gimbal_reaches_what_is_ahead_and_not_what_touches_the_lens() -> None:
    body = Body(camera_m=(0.1, 0.0, 0.0), pan_limit_deg=(-90.0, 90.0))
    here = (1.0, 1.0, math.pi)
    assert reaches(body, here, (0.4, 1.0, 0.2)) and reaches(body, here, (0.89, 1.4, 0.2))
    assert not reaches(body, here, (1.2, 1.0, 0.2)) and not reaches(body, here, (0.91, 1.4, 0.2))
    assert not reaches(body, here, (0.85, 1.0, 0.2))


def test_dives_add_up_and_lost_words_have_their_price() -> None:
    fine, far = ({"speed_m_s": 0.15, **row_of(CASE, drawn(error_m=np.full((N, 3), m)))} for m in (0.010, 0.020))
    free, lossy = ({k: [far if k == slow else fine] for k in range(5)} for slow in (1, 0))
    told = measure(CLAIM, {"share-3": free, "share-3-loss30": lossy})
    assert told["share-3_0.15_rms_mm"].value == pytest.approx(math.sqrt(160.0))
    cost = told["share-3-loss30_0.15_cost"]
    assert cost.low < 1.0 < cost.high and cost.value == pytest.approx(1.0)
    judged = {figure.key: verdict(figure, told[figure.key]) for figure in CLAIM.figures if figure.key in told}
    # All of the time in five dives: nobody knows of the sixth.
    assert told["share-3_0.15_each"].value == 100.0 and told["share-3_0.15_each"].low == pytest.approx(54.9, abs=0.1)
    assert judged["share-3_0.15_each"] == judged["share-3-loss30_0.15_cost"] == "not shown"
    unknown = drawn(error_m=np.full((N, 3), np.nan), nees=np.full((N, 3), np.nan))
    alone = summary({"silent-3": [{"speed_m_s": 0.1, **row_of(CASES["silent-3"], unknown)}]})
    assert alone["silent-3_0.10_rms_mm"] is alone["silent-3_0.10_nees"] is None and alone["silent-3_0.10_known"] == 0.0


def test_weeds_hide_and_nothing_swims_through_them() -> None:
    weed = Pillar(1.5, 1.0, 0.1)
    assert hides(weed, (1.0, 1.0), (2.0, 1.1, 0.2)) and not hides(weed, (1.0, 1.0), (1.4, 1.0, 0.2))
    for seed in range(3):
        pillars = following_dive.weeds(seed)
        wanderer = Wanderer(generator(seed, "follow"), 0.2, 40.0, pillars)
        for k in range(400):
            x, y, _ = wanderer.at(10**18 + k * 100_000_000)
            assert all(math.hypot(x - p.x_m, y - p.y_m) > p.radius_m + 0.9 * BODY_M for p in pillars)
