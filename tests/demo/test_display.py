"""The demo's tables on a terminal of 80 columns: nothing that matters is cut off."""

import io

import msgspec
from rich.console import Console

from agent.core.messages import NeighbourState, State
from agent.demo.display import progress_row, progress_table, progress_title, result_table, verdict
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
    row |= {"outside_mm": 1.26, "allowed_mm": 8.0}
    never = dict.fromkeys(row) | {"iterations": 50}
    about = {"truth_m": [0.76, 0.56, 0.07], "radii_m": [0.03, 0.09, 0.06], "agents": {"r1": row, "r2": never}}
    text = shown(result_table({"protocol": "evidence", "seed": 1, "targets": {"rock": about}}, "rock"))
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    r1, r2 = (line.split() for line in text.splitlines() if line.split()[:1] in (["r1"], ["r2"]))
    assert r1 == ["r1", "9", "50", "-24.0", "+1.5", "+0.4", "1.3", "8.0"]
    assert r2 == ["r2", "never", "50", "-", "-"]


def test_a_track_is_shown_with_the_bars_that_it_missed() -> None:
    fleet = load_fleet(fleet_file("fish"))
    about = score_following(swum(lost=range(60)), fleet, "fish")
    summary = {"protocol": "evidence", "seed": 1, "verdict": "pass", "reasons": [], "targets": {"fish": about}}
    text = shown(result_table(summary, "fish"))
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text
    assert "40 s" in text and "30.0" in text and "85.0 %" in text
    assert "missed: by two 95 %, by each 88 %, track 25 mm rms, NEES" in " ".join(text.split())
    assert verdict(summary).startswith("pass: one robot at least saw it for 95 % of the time")


def test_a_survey_is_judged_by_what_is_known_not_by_targets() -> None:
    summary = {"coverage": {"wanted_share": 0.5}, "verdict": "pass", "reasons": [], "targets": {"ball": {}}}
    assert verdict(summary) == "pass: every robot knows 50.0 % of what is wanted at least, and all maps are the same"
    assert verdict(summary | {"verdict": "fail", "reasons": ["the maps differ"]}) == "fail: the maps differ"


def test_what_people_ordered_stands_with_the_faults() -> None:
    assert progress_row(msgspec.structs.replace(STATE, faults=(), armed=False))[-1] == "motors off"
    ordered = msgspec.structs.replace(STATE, faults=("no frames",), armed=False, ordered=("ann: stop",))
    assert progress_row(ordered)[-1] == "no frames, ann: stop"
