"""The scores of a run, from made-up states."""

import math
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import Target
from agent.core.messages import State, Whereabouts
from agent.demo.display import verdict
from agent.demo.summary import (
    History,
    doubts,
    first_below,
    outside_m,
    reasons,
    score,
    settled,
    summarize,
    whereabouts,
    whereabouts_lines,
)
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet

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
    assert summary["incarnations"] == {"r1": [good["r1"].states[0].incarnation]}
    fault = "not recording: the disk has taken nothing for more than 10 s"
    silent = {"r1": History([replace(good["r1"].states[0], faults=(fault,))])}
    summary = summarize(fleet, {"ball": silent, "buoy": silent}, truth, 1.0)
    assert summary["verdict"] == "fail" and summary["reasons"] == [f"r1: {fault}"]
    summary = summarize(fleet, {"ball": good, "buoy": bad}, truth, 1.0)
    assert summary["verdict"] == "fail"
    assert summary["reasons"][0].startswith("buoy: r1: relative error 2.1")


def test_it_has_what_each_robot_said_last_of_its_own_belief_and_that_decides_nothing() -> None:
    fleet = load_fleet(fleet_file("tank"))
    before = state(4, 0.001, acquired_t=1, verdict="missing", causes=("r1, r2 do not see it",))
    after = state(5, 0.001, acquired_t=1, verdict="suspect", causes=("r2 stands apart",))
    of_target = {"r1": History([before, after]), "r2": History([before, state(5, 0.001, acquired_t=1)])}
    summary = summarize(fleet, {"ball": of_target | {"r3": History([])}}, {"target_m": {"ball": TRUTH}}, 1.0)
    agents = summary["targets"]["ball"]["agents"]
    assert (agents["r1"]["verdict"], agents["r1"]["causes"]) == ("suspect", ["r2 stands apart"])
    assert (agents["r2"]["verdict"], agents["r2"]["causes"]) == ("consistent", [])
    assert (agents["r3"]["verdict"], agents["r3"]["causes"]) == (None, [])
    assert doubts(summary) == ["r1 ended suspect: r2 stands apart"]
    assert not any("suspect" in reason for reason in summary["reasons"])


RADII = (0.03, 0.09, 0.06)  # of a thing in a box around TRUTH


@pytest.mark.parametrize(
    ("place", "outside"),
    [
        (TRUTH, 0.0),
        ((0.76, 0.645, 0.07), 0.0),  # on its long axis, in it
        ((0.76, 0.67, 0.07), 0.02),
        ((0.70, 0.56, 0.07), 0.03),  # as far from the middle as the surface at the other axis
        ((0.76, 0.56, 0.16), 0.03),
    ],
)
def test_how_far_outside_of_a_thing_a_place_lies(place: tuple[float, ...], outside: float) -> None:
    assert outside_m(place, TRUTH, RADII) == pytest.approx(outside)


def test_a_thing_in_a_box_is_judged_by_its_surface_and_the_robots_own_sigma() -> None:
    def row(error_m: float | None, sigma_m: float | None) -> dict:
        return score(History([state(5, error_m, posterior_sigma_m=sigma_m)]), TRUTH, RADII)

    on_it, beside = row(0.031, 0.001), row(0.036, 0.001)
    assert (on_it["outside_mm"], on_it["allowed_mm"]) == (pytest.approx(1.0), pytest.approx(3.0))
    assert on_it["relative_error_percent"] is None and on_it["below_0_4_percent_from"] is None
    assert reasons({"r1": on_it}) == [], "nor need it be seen by all"
    assert reasons({"r1": on_it, "r2": beside}) == ["r2: 6.0 mm outside of it > 3.0 mm"]
    assert reasons({"r1": row(0.5, 100.0)}) == ["r1: 470.0 mm outside of it > 90.0 mm"], "it knows nothing"
    assert reasons({"r1": row(None, None)}) == ["r1 has no estimate"]


def test_a_thing_in_a_box_in_the_summary_beside_a_ball() -> None:
    fleet = load_fleet(fleet_file("two_balls"))
    rock = Target(detector="box", picture="rock.png", box=(0, 0, 9, 9))
    fleet = replace(fleet, target={"ball": fleet.target["ball"], "rock": rock})
    good = {"r1": History([state(5, 0.001, acquired_t=1, posterior_sigma_m=0.001)])}
    truth = {"target_m": {"ball": TRUTH, "rock": TRUTH}, "target_radii_m": {"ball": (0.07,) * 3, "rock": RADII}}
    summary = summarize(fleet, {"ball": good, "rock": good}, truth, 1.0)
    assert summary["verdict"] == "pass"
    assert (summary["targets"]["ball"]["radii_m"], summary["targets"]["rock"]["radii_m"]) == (None, RADII)
    assert "outside_mm" not in summary["agents"]["r1"]
    words = "pass: every robot's error is below 0.4 %; every robot's estimate lies on the thing, to within 3 sigma"
    assert verdict(summary) == words


def test_who_is_told_of_a_thing_in_a_box_has_settled_too() -> None:
    told = History([state(t, 0.001 if t > 5 else None) for t in range(40)])
    assert settled([told], after_views=30, window=10, within_m=0.0015, all_see=False)
    assert not settled([told], after_views=30, window=10, within_m=0.0015)
    assert not settled([told], after_views=35, window=10, within_m=0.0015, all_see=False)


def test_how_far_off_and_how_honest_a_robot_that_swims_was(tmp_path: Path) -> None:
    head = "t_ns,robot,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,pan_deg,tilt_deg"
    rows = [f"{t},r1,{0.1 * t},1.0,0.3,0,0,{yaw},0,0" for t, yaw in ((0, 170.0), (10, -170.0))]
    (tmp_path / "paths.csv").write_text("\n".join((head, *rows)) + "\n")
    there = Whereabouts(x_m=0.53, y_m=1.04, yaw_deg=-179.0, place_sigma_m=0.025, yaw_sigma_deg=2.0)
    after = Whereabouts(x_m=9.0, y_m=9.0, yaw_deg=0.0, place_sigma_m=0.01, yaw_sigma_deg=1.0)
    states = [state(5, None, whereabouts=there), state(6, None), state(11, None, whereabouts=after)]
    histories = {"ball": {"r1": History(states), "r2": History([])}}
    off = whereabouts(tmp_path, histories)
    assert off == {"r1": {"place_mm": 50.0, "place_sigmas": 2.0, "yaw_deg": 1.0, "yaw_sigmas": 0.5}}
    (line,) = whereabouts_lines(off)
    assert line.startswith("r1 believed to be 50.0 mm and 1.00 deg")
    assert whereabouts(tmp_path / "moored", histories) == {}
