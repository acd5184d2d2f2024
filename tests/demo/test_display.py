"""The demo's tables on a terminal of 80 columns: nothing that matters is cut off."""

import io

import msgspec
from rich.console import Console

from agent.core.messages import NeighbourState, State
from agent.demo.display import progress_row, progress_table, progress_title, result_table, trust, verdict
from agent.demo.summary import History, score_following
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from tests.swum_track import swum

NEIGHBOURS = tuple(NeighbourState(robot=f"r{k}", age_s=0.1, valid=True) for k in (2, 3, 4, 5))
STATE = State(
    fleet="tank",
    robot="r1",
    incarnation=1,
    seq=1,
    sent_ns=1,
    target="ball",
    knows="sees",
    t=146,
    acquired_t=12,
    posterior_m=(1.0596, 0.559, 0.07),
    posterior_sigma_m=0.0019,
    neighbours=NEIGHBOURS,
    faults=("no frames", "no telemetry"),
)


def shown(table) -> str:
    console = Console(width=80, file=io.StringIO())
    console.print(table)
    return console.file.getvalue()


def test_progress_of_five_robots_shows_estimate_neighbours_and_faults() -> None:
    text = shown(progress_table({"ball": {"r1": History([STATE]), "r2": History([])}}, progress_title(23.0, 73.0, 1.5)))
    assert max(map(len, text.splitlines())) <= 80
    for word in ("sees", "146", "1059.6 559.0 70.0", "1.9", *["r2", "r3", "r4", "r5"], "frames", "telemetry"):
        assert word in text, word
    assert "23 s into the dive, at 1.50 times real time; at most 50 s to go" in text
    assert text.count("…") == 1  # r2 has said nothing yet; no cell is cut


def test_the_result_says_never_only_of_who_never_saw() -> None:
    row = {
        "iterations": 50,
        "prior_rmse_axis_mm": [10.6, 2.7, 1.0],
        "error_axis_mm": [-10.7, 12.5, -0.4],
        "error_mm": 16.46,
        "relative_error_percent": 1.73,
    }
    blind = {**row, "prior_rmse_axis_mm": None, "error_axis_mm": None, "error_mm": None, "relative_error_percent": None}
    agents = {"r1": {**row, "acquired_iteration": 12}, "r2": {**blind, "acquired_iteration": None}}
    summary = {
        "protocol": "evidence",
        "seed": 1,
        "targets": {"ball": {"truth_m": [0.76, 0.56, 0.07], "radii_m": None, "agents": agents}},
    }
    text = shown(result_table(summary, "ball"))
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    assert "ball at (0.76, 0.56, 0.07) m" in text
    r1, r2 = (line for line in text.splitlines() if line.split()[:1] in (["r1"], ["r2"]))
    assert "never" in r2 and "never" not in r1 and "-10.7 +12.5 -0.4" in r1


def test_a_thing_in_a_box_has_columns_of_its_own() -> None:
    row = {"iterations": 50, "acquired_iteration": 9, "error_axis_mm": [-24.0, 1.5, 0.4]}
    row |= {"outside_mm": 1.26, "allowed_mm": 8.0, "verdict": "missing"}
    never = dict.fromkeys(row) | {"iterations": 50}
    about = {"truth_m": [0.76, 0.56, 0.07], "radii_m": [0.03, 0.09, 0.06], "agents": {"r1": row, "r2": never}}
    text = shown(result_table({"protocol": "evidence", "seed": 1, "targets": {"rock": about}}, "rock"))
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    r1, r2 = (line.split() for line in text.splitlines() if line.split()[:1] in (["r1"], ["r2"]))
    assert r1 == ["r1", "9", "50", "-24.0", "+1.5", "+0.4", "1.3", "8.0", "missing"]
    assert r2 == ["r2", "never", "50", "-", "-", "-"]


def test_a_track_is_shown_with_the_bars_that_it_missed() -> None:
    fleet = load_fleet(fleet_file("fish"))
    about = score_following(swum(lost=range(110)), fleet, "fish")
    about["agents"]["r1"] |= {"verdict": "contradicted", "causes": []}
    summary = {"protocol": "evidence", "seed": 1, "verdict": "pass", "reasons": [], "targets": {"fish": about}}
    text = shown(result_table(summary, "fish"))
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text and "contradicted" in text
    assert "35 s" in text and "30.0" in text and "82.9 %" in text
    assert "missed: by two 95 %, by the least robot 85 %, track 25 mm rms." in " ".join(text.split())
    assert verdict(summary).startswith("pass: one robot at least saw it for 95 % of the time")


def test_a_survey_is_judged_by_what_is_known_not_by_targets() -> None:
    summary = {"coverage": {"wanted_share": 0.5}, "verdict": "pass", "reasons": [], "targets": {"ball": {}}}
    assert verdict(summary) == "pass: every robot knows 50.0 % of what is wanted at least, and all maps are the same"
    assert verdict(summary | {"verdict": "fail", "reasons": ["the maps differ"]}) == "fail: the maps differ"


def test_what_people_ordered_stands_with_the_faults() -> None:
    assert progress_row(msgspec.structs.replace(STATE, faults=(), armed=False))[-1].plain == "consistent, motors off"
    ordered = msgspec.structs.replace(STATE, faults=("no frames",), armed=False, ordered=("ann: stop",))
    assert progress_row(ordered)[-1].plain == "consistent, no frames, ann: stop"
    text = shown(progress_table({"ball": {"r1": History([ordered])}}, "a dive"))
    assert "remarks" in text and "faults" not in text, "what people ordered is no fault"
    blind = msgspec.structs.replace(STATE, knows="blind", posterior_m=None, faults=())
    assert progress_row(blind)[-1].plain == "", "of what it knows nothing about there is nothing to trust"


LONG = "all ranges are 2.0 % (+-0.2) long: check radius_m, refractive_index and the survey"


def test_whether_a_belief_can_be_trusted_stands_in_the_table_in_colour_and_why_below() -> None:
    """Of each target its own word; the faults of a robot have those of all its targets."""
    faults = (f"contradicted: ball: {LONG}", "missing: buoy: r1, r2 look where it was and do not see it", "no frames")
    ball = msgspec.structs.replace(STATE, verdict="contradicted", causes=(LONG,), faults=faults)
    buoy = msgspec.structs.replace(STATE, target="buoy", faults=faults)
    assert progress_row(ball)[-1].plain == "contradicted, no frames"
    assert progress_row(buoy)[-1].plain == "consistent, no frames"
    colours = [trust(word).style for word in ("consistent", "suspect", "contradicted", "missing")]
    assert colours == ["green", "yellow", "red", "red"]
    text = shown(progress_table({"ball": {"r1": History([ball])}, "buoy": {"r1": History([buoy])}}, "a dive"))
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text and "contradicted" in text
    assert f"ball, r1: {LONG}" in " ".join(text.split())


def test_the_result_and_the_last_sentence_say_who_ended_how() -> None:
    row = {
        "iterations": 50,
        "acquired_iteration": 12,
        "prior_rmse_axis_mm": [10.6, 12.7, 11.0],
        "error_axis_mm": [-10.7, 12.5, -10.4],
        "error_mm": 16.46,
        "relative_error_percent": 1.73,
    }
    bad = {**row, "verdict": "contradicted", "causes": [LONG, "r2 stands apart"]}
    agents = {"r1": bad, "r2": {**row, "verdict": "consistent", "causes": []}}
    ball = {"truth_m": [0.76, 0.56, 0.07], "radii_m": None, "agents": agents}
    summary = {"protocol": "evidence", "seed": 1, "verdict": "pass", "reasons": [], "targets": {"ball": ball}}
    text = shown(result_table(summary, "ball"))
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    assert [line.split()[-1] for line in text.splitlines() if line.split()[:1] in (["r1"], ["r2"])] == [
        "contradicted",
        "consistent",
    ]
    assert verdict(summary).endswith(f"below 0.4 %; r1 ended contradicted: {LONG}")
    both = summary | {"targets": {"ball": ball, "buoy": ball | {"agents": {}}}}
    assert verdict(both).endswith(f"; r1 ended contradicted about ball: {LONG}")
