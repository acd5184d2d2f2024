"""A gimbal that was turned away on purpose comes back at once, and what was learnt of the target is kept."""

import pytest
from msgspec.structs import replace

from agent.core.capability import CameraAct, LightView
from agent.core.ranging.camera_model import look_at
from agent.core.ranging.sweep import SLACK_NS, Measurement, Rejected
from agent.core.step_io import Sighting
from agent.robot.target_search import LOST_NS, PATIENCE, TURN, FixedFocus, TargetScheduler, TargetSearch
from tests.capabilities.swim.swimming_agent import CALIBRATION, POSE, fleet
from tests.core.situations import LEVEL, situation

START_NS, STEP_NS, S = 10**18, 50_000_000, 1_000_000_000
TOLD_M = (1.7, 1.5, 0.2)  # where others say that the ball is


@pytest.fixture
def target_search():
    of = fleet()
    target_search = TargetSearch(of, of.robot["r1"], CALIBRATION)
    act(target_search, START_NS)
    return target_search


def act(target_search, now_ns, told_m=TOLD_M):
    return target_search.act(situation(target_search, now_ns, told_m), True)


def test_it_waits_before_it_believes_that_a_target_is_lost(target_search) -> None:
    goal_us, now_ns = target_search.pointing.goal_us, target_search.pointing.steady_from_ns
    act(target_search, now_ns + LOST_NS)
    assert target_search.pointing.goal_us == goal_us
    act(target_search, now_ns + LOST_NS + STEP_NS)
    assert target_search.pointing.goal_us != goal_us


def test_after_a_look_elsewhere_it_turns_to_the_target_at_once(target_search) -> None:
    now_ns = target_search.pointing.steady_from_ns + STEP_NS
    target_search.add_sighting(
        Sighting(t_ns=now_ns, frame=1, target="ball", found=True, centre_px=(320.0, 240.0), radius_px=40.0), LightView()
    )
    plan = act(target_search, now_ns)
    for index, lens in enumerate(plan.focus[1:], start=1):  # a peak at 300
        clarity = 1.0 / (1.0 + ((lens - 300.0) / 60.0) ** 2)
        now_ns += STEP_NS
        seen = Sighting(
            t_ns=now_ns, frame=1 + index, sweep=plan.sweep, index=index, focus=lens, target="ball", found=True,
            centre_px=(320.0, 240.0), radius_px=40.0, clarity=clarity, area_px=2000.0,
        )  # fmt: skip
        target_search.add_sighting(seen, LightView())
    assert target_search.finish(now_ns) is not None
    target_search.carry_out(CameraAct((-60.0, 0.0)), now_ns)
    away_us, now_ns = target_search.pointing.goal_us, now_ns + STEP_NS  # on its way still
    act(target_search, now_ns)
    assert target_search.pointing.goal_us != away_us
    pan_deg, _ = look_at(TOLD_M, POSE, fleet().body, *LEVEL, fleet().tank.surface_m)
    assert target_search.gimbal_deg()[0] == pytest.approx(pan_deg, abs=0.2)
    now_ns = target_search.pointing.steady_from_ns + STEP_NS
    target_search.add_sighting(
        Sighting(t_ns=now_ns, frame=99, target="ball", found=True, centre_px=(320.0, 240.0), radius_px=40.0),
        LightView(),
    )
    again = act(target_search, now_ns)
    assert len(again.focus) < len(plan.focus)  # it looks around the peak that it knows


# --- target scheduler ---
# TargetScheduler of the camera: robots that share an index agree on whose turn it is, and nobody starves.

THREE = ("ball", "buoy", "fish")


def test_one_target_has_every_turn() -> None:
    turns = TargetScheduler(("ball",))
    assert {turns.next({"ball": t}) for t in range(50)} == {"ball"}


def test_each_has_its_turn_in_the_order_of_the_fleet_file() -> None:
    turns, t, seen = TargetScheduler(THREE), dict.fromkeys(THREE, 0), []
    for _ in range(2 * len(THREE) * TURN):
        t[turns.target] += 1
        seen.append(turns.target)
        turns.next(t)
    assert seen == [name for _ in range(2) for name in THREE for _ in range(TURN)]


def test_a_restarted_robot_joins_the_turn_of_the_others() -> None:
    turns = TargetScheduler(THREE)
    t = {"ball": 3 * TURN, "buoy": 2 * TURN + 2, "fish": 2 * TURN}  # after its first iteration, indices adopted
    assert turns.next(t) == "fish"
    turns = TargetScheduler(THREE)
    assert turns.next({**t, "fish": 3 * TURN}) == "buoy"
    assert turns.next({**t, "fish": 3 * TURN, "buoy": 3 * TURN - 1}) == "buoy"
    assert turns.next({**t, "fish": 3 * TURN, "buoy": 3 * TURN}) == "ball"


def test_a_target_whose_index_others_drive_is_looked_at_all_the_same() -> None:
    turns, t, waited, longest = TargetScheduler(THREE), dict.fromkeys(THREE, 0), 0, 0
    for _ in range(200):
        t["buoy"] += 3  # by a neighbour that knows nothing else
        t[turns.target] += 1
        waited = 0 if turns.next(t) == "buoy" else waited + 1
        longest = max(longest, waited)
    assert longest <= (PATIENCE * len(THREE) + 1) * TURN


def test_a_camera_of_fixed_focus_measures_without_a_plan() -> None:
    of = fleet()
    search = TargetSearch(of, of.robot["r1"], replace(CALIBRATION, focus=None))
    act(search, START_NS)
    now_ns = search.pointing.steady_from_ns + STEP_NS
    for step in range(2):  # it comes into view, and is measured
        seen = Sighting(t_ns=now_ns, frame=step, target="ball", found=True, centre_px=(320.0, 240.0), radius_px=40.0)
        search.add_sighting(seen, LightView())
        assert isinstance(search.finish(now_ns), Measurement) == (step == 1)
        assert act(search, now_ns) is None
        now_ns += STEP_NS


def test_where_the_focus_is_fixed_the_next_frame_is_the_measurement() -> None:
    look = FixedFocus()
    frame = Sighting(t_ns=S - 1, frame=1, target="ball", found=True, centre_px=(300.0, 240.0), radius_px=99.0)
    assert look.start(S) is None and look.running
    look.frame(frame)  # exposed before
    assert look.finish(S) is None
    look.frame(replace(frame, t_ns=S + 1, frame=2, centre_px=(320.0, 240.0)))
    look.frame(replace(frame, t_ns=S + 2, frame=3))
    found = look.finish(S + 3)
    assert isinstance(found, Measurement) and found.lens_position is None
    assert (found.t_ns, found.outline.centre_px, found.outline.radius_px) == (S + 1, (320.0, 240.0), 99.0)
    assert look.ready(S + 3) and look.finish(S + 4) is None
    look.start(S)
    assert look.finish(S + SLACK_NS) == Rejected(2, "no frame in time")
    look.start(S)
    look.frame(replace(frame, t_ns=S, found=False, centre_px=None))
    assert look.finish(S) == Rejected(3, "target not seen in the frame")
