"""What came of a run, in one sentence: each outcome, from figures alone."""

import pytest

from replay.report.lead import Found, Outcome, RobotOutcome, Survey, millimetres, plain, seconds, sentence

FLEET = ("r1", "r2", "r3")
HEARD = {name: RobotOutcome(60.0) for name in FLEET}
SEEN = Found(
    "ball",
    seen_s={"r1": 8.2, "r2": 4.0, "r3": 9.0},
    known_s={"r1": 5.0, "r2": 4.0, "r3": 5.2},
    sigma_m={"r1": 0.001, "r2": 0.0012, "r3": 0.001},
    off_m={"r1": 0.002, "r2": 0.0031, "r3": 0.001},
)
WELL = Outcome(FLEET, HEARD, (SEEN,))
ALL_SAW = "All three robots saw the ball (r2 first, after 4.0 s); "


def said(about: Outcome) -> str:
    return plain(sentence(about))


def with_target(**changed: object) -> Outcome:
    return WELL._replace(targets=(SEEN._replace(**changed),))


def test_all_saw_it_and_the_truth_is_known() -> None:
    assert said(WELL) == f"{ALL_SAW}at the end all knew its place to ± 1.2 mm, and were at most 3.1 mm off."
    assert [part.kind for part in sentence(WELL)] == ["good"]


def test_of_a_thing_with_a_size_it_is_no_error() -> None:
    assert said(with_target(has_size=True)).endswith("± 1.2 mm, and were at most 3.1 mm from its middle.")


def test_without_a_truth_it_says_how_far_they_agree() -> None:
    assert said(with_target(off_m={}, apart_m=0.004)) == (
        f"{ALL_SAW}at the end all knew its place to ± 1.2 mm, within 4.0 mm of each other."
    )
    assert "within 0.1 mm of each other" in said(with_target(off_m={}, apart_m=0.0))
    assert said(with_target(off_m={})).endswith("at the end all knew its place to ± 1.2 mm.")


def test_one_found_it_others_were_told_or_never_knew() -> None:
    about = with_target(seen_s={"r2": 12.4}, known_s={"r2": 12.4, "r1": 13.0}, sigma_m={"r2": 0.02}, off_m={"r2": 0.03})
    assert said(about) == (
        "r2 found the ball after 12 s, r1 was told of it, r3 never knew of it; "
        "at the end r2 knew its place to ± 20 mm, and was 30 mm off, r1 no longer did."
    )


def test_all_were_told_by_somebody_who_left_no_recording() -> None:
    about = with_target(seen_s={}, off_m={})
    assert said(about).startswith(
        "All three robots heard of the ball after 4.0 s and never saw it; at the end all knew"
    )


def test_nobody_found_it_or_nobody_knows_it_any_more() -> None:
    nobody = with_target(seen_s={}, known_s={}, sigma_m={}, off_m={})
    assert said(nobody) == "Nobody found the ball in 60 s."
    assert [part.kind for part in sentence(nobody)] == ["bad"]
    lost = with_target(sigma_m={}, off_m={})
    assert said(lost) == f"{ALL_SAW}at the end nobody knew where it is."
    assert [part.kind for part in sentence(lost)] == ["bad"]


def test_one_that_swims_was_in_view_and_its_track_is_off() -> None:
    about = with_target(in_view=(0.8, 0.954), track_rms_m=0.097)
    assert said(about) == (
        "All three robots saw the ball (r2 first, after 4.0 s), in view for 80 % to 95 % of the time; "
        "at the end all knew its place to ± 1.2 mm, and on the way were 97 mm off (rms)."
    )
    assert "in view for 80 % of the time" in said(with_target(in_view=(0.8, 0.8)))


def test_each_of_several_targets_has_its_clause() -> None:
    buoy = Found("buoy", {}, {}, {}, {})
    about = WELL._replace(targets=(SEEN, buoy))
    assert said(about).endswith("3.1 mm off; nobody found the buoy in 60 s.")
    assert [part.kind for part in sentence(about)] == ["good", "bad"]


@pytest.mark.parametrize(("share", "kind"), [(0.51, "good"), (0.49, "bad")])
def test_a_survey_is_about_what_is_known(share: float, kind: str) -> None:
    unseen = Found("ball", {}, {}, {}, {})
    about = WELL._replace(targets=(unseen,), survey=Survey(share, 0.5, 52, alike=True))
    known = f"{100 * share:.0f} % of what is wanted is known after 60 s"
    assert said(about) == f"{known}, from 52 keyframes, and 50 % were asked for."
    assert [part.kind for part in sentence(about)] == [kind]
    assert "the maps differ" in said(about._replace(survey=Survey(share, 0.5, 52, alike=False)))


def test_what_went_wrong_follows() -> None:
    def wrong(**robot: object) -> str:
        return said(WELL._replace(robots={**HEARD, "r3": RobotOutcome(60.0)._replace(**robot)})).split(" mm off; ")[1]

    assert wrong(ends_s=40.0) == "r3 ended after 40 s of 60 s."
    assert wrong(ends_s=40.0, ending="silent") == "r3 fell silent after 40 s of 60 s."
    assert wrong(ends_s=40.0, ending="torn") == "the recording of r3 breaks off after 40 s of 60 s."
    assert wrong(ends_s=40.0, mode="failed") == "r3 failed after 40 s."
    assert wrong(starts=2) == "r3 started again."
    assert wrong(starts=4) == "r3 started again 3 times."
    assert wrong(faults=("no frames",)) == "r3 ended with “no frames”."
    assert wrong(warned=("lens", "tilt", "clock")) == "r3 warned of “lens” and two more."
    assert " off; " not in said(WELL._replace(robots={**HEARD, "r3": RobotOutcome(57.5)}))  # ended as the others did
    assert {part.kind for part in sentence(WELL._replace(torn=("r1.mcap",)))} == {"good", "bad"}


def test_what_went_wrong_with_several_stands_once() -> None:
    about = WELL._replace(robots=dict.fromkeys(FLEET, RobotOutcome(60.0, faults=("no frames",))))
    assert said(about).endswith("off; all three robots ended with “no frames”.")


def test_of_a_run_it_says_what_is_missing_torn_and_why_it_did_not_pass() -> None:
    about = WELL._replace(
        robots={"r1": RobotOutcome(60.0), "r3": RobotOutcome(60.0)},
        missing=("r2",),
        torn=("r1.mcap", "r3.mcap"),
        verdict="fail",
        reasons=("r2 never saw it",),
    )
    assert said(about).split(" off; ")[1] == (
        "nothing was heard of r2; not finished by their writers: r1.mcap and r3.mcap; "
        "it did not pass: “r2 never saw it”."
    )
    assert said(WELL._replace(verdict="pass")) == said(WELL)
    assert said(WELL._replace(verdict="fail")).endswith("; it did not pass.")


def test_nothing_was_left() -> None:
    about = Outcome(FLEET, {}, (SEEN,), missing=FLEET, verdict="fail", reasons=("r1 is lost", "r2 is lost"))
    assert said(about) == (
        "No robot of this run left a recording that can be read; it did not pass: “r1 is lost” and one more."
    )


def test_a_name_of_a_robot_is_not_made_a_capital() -> None:
    about = with_target(seen_s={"r2": 4.0}, known_s={"r2": 4.0})
    assert said(about).startswith("r2 found the ball")
    both = {"a": 1.0, "b": 2.0}
    found = SEEN._replace(seen_s=both, known_s=both, sigma_m={"a": 0.001})
    pair = Outcome(("a", "b"), {name: RobotOutcome(1.0) for name in "ab"}, (found,))
    assert said(pair).startswith("Both robots saw the ball (a first")


def test_numbers_are_as_long_as_they_say_something() -> None:
    assert [seconds(s) for s in (0.04, 9.94, 9.96, 119.4, 120.0, 134.4, 179.8)] == [
        "0.0 s", "9.9 s", "10 s", "119 s", "2 min", "2 min 14 s", "3 min",
    ]  # fmt: skip
    assert [millimetres(m) for m in (0.00004, 0.0099, 0.00996, 0.1)] == ["0.0 mm", "9.9 mm", "10 mm", "100 mm"]
