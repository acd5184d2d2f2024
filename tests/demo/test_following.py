"""What following is said to be worth, against a track made by hand."""

import pytest
from msgspec.structs import replace

from agent.core.messages import State
from agent.demo.summary import FOLLOW_S, History, followed_s, reasons_following, score_following, swims
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from tests.swum_track import OFF_M, SIGMA_M, swum

FISH = load_fleet(fleet_file("fish"))
FLEET = replace(FISH, robot={name: FISH.robot[name] for name in ("r1", "r2")})


def test_shares_of_time_errors_and_losses_are_those_of_the_track():
    row = score_following(swum(), FLEET, "fish")
    assert row["followed_s"] == pytest.approx(35.0), "from 5 s after the first robot saw it"
    assert row["seen_by_one"] == 1.0
    assert row["seen_least"] == row["seen_by_two"] == pytest.approx(1 - 20 / 351)
    assert row["seen_mean"] == pytest.approx(1 - 10 / 351)
    assert row["whole"]["followed_s"] == pytest.approx(40.0)
    assert row["whole"]["seen_least"] == pytest.approx(1 - 20 / 401)
    assert row["agents"]["r1"]["times_lost"] == 0 and row["agents"]["r2"]["times_lost"] == 1
    assert row["agents"]["r2"]["longest_unseen_s"] == pytest.approx(2.0)
    assert row["track_rms_mm"] == pytest.approx(1e3 * OFF_M)
    assert row["nees"] == pytest.approx((OFF_M / SIGMA_M) ** 2)
    assert row["bars"] == {
        "seen_by_one": True,
        "seen_by_two": False,
        "seen_least": True,
        "track_rms_mm": False,
        "nees": True,
    }
    assert reasons_following(row) == []


def test_frames_that_are_old_show_nothing_of_now():
    track = swum()
    few = {**track.looks, "r1": track.looks["r1"][::10]}
    row = score_following(track._replace(looks=few), FLEET, "fish")
    assert row["agents"]["r1"]["seen"] == pytest.approx(0.4, abs=0.01)  # 0.3 s of each second, ends included


def test_who_is_surer_than_right_farther_off_than_its_length_or_blind_fails():
    track = swum(lost=range(250))
    far = [h._replace(x_m=(h.x_m[0] + 0.2, *h.x_m[1:])) for h in track.held["r2"]]
    why = reasons_following(score_following(track._replace(held={**track.held, "r2": far}), FLEET, "fish"))
    assert [text.partition(":")[0].partition(" ")[0] for text in why] == ["each", "r2", "r2"]
    assert "43.0 % of the time < 50 %" in why[0]
    assert "230 mm rms, more than the creature's length, 150" in why[1]
    assert "surer than right" in why[2]


def test_a_robot_that_never_knew_it_fails_and_no_truth_is_no_pass():
    track = swum()
    assert reasons_following(score_following(track._replace(held={**track.held, "r2": []}), FLEET, "fish")) == [
        "r2 never knew where it is"
    ]
    assert reasons_following(score_following(None, FLEET, "fish")) != []


def test_a_dive_goes_on_until_all_have_known_it_for_long_enough():
    def state(robot: str, s: float, known: bool) -> State:
        place = (1.0, 1.0, 0.2) if known else None
        return State(
            fleet="fish",
            robot=robot,
            incarnation=1,
            seq=1,
            sent_ns=round(s * 1e9),
            target="fish",
            knows="told",
            t=1,
            signed=False,
            mode="running",
            posterior_m=place,
        )

    r1 = History([state("r1", 1.0, True), state("r1", 80.0, True)])
    r2 = History([state("r2", 1.0, False), state("r2", 15.0, True), state("r2", 79.0, True)])
    assert followed_s({"r1": r1, "r2": r2}) == pytest.approx(64.0) and FOLLOW_S < 64.0
    assert followed_s({"r1": r1, "r2": History(r2.states[:1])}) == 0.0
    assert swims(FISH, "fish")
