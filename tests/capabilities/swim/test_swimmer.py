"""A robot that swims, whole: what its camera sees goes in, what its thrusters are asked for moves it."""

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.swim.deconfliction import pace
from agent.capabilities.swim.event_ring import RING_NS
from agent.capabilities.swim.localizer import LOST_M, UNSURE_DEG, UNSURE_M, within
from agent.capabilities.swim.swimmer import ARRIVED_NS, BRAKES_NS, calm
from agent.core.codec import encode
from agent.core.config import Goto, Limits, Look, Navigation, Orbit, Target, Turn
from agent.core.estimation.interface import Prior
from agent.core.step_io import Heard
from agent.core.step_transaction import SURFACE_M
from agent.core.topics import NEAR
from agent.robot.step import Agent
from tests.capabilities.swim.swimming_agent import CALIBRATION, DEPTH_M, POSE, START_NS, STEP_NS, InTank, fleet
from tests.capabilities.swim.swimming_fleet import FleetInTank, fleet_of
from tests.sample_messages import presence

THERE = POSE.x_m, POSE.y_m, POSE.yaw_deg
AT_REST = (0.0, 0.0, 0.0)
ASTRAY = (POSE.x_m + 0.24, POSE.y_m + 0.18, np.radians(POSE.yaw_deg + 20.0))  # 0.3 m and 20 degrees off


# --- finding itself and getting there ---------------------------------------------------------------------------


def test_it_finds_itself_swims_to_its_pose_and_stays(swum) -> None:
    one, told = swum
    forces = [(*outputs.set_point.force_n, outputs.set_point.yaw_moment_nm) for _, _, outputs, _, _ in told]
    knew = [known for *_, known in told]
    first = knew.index(True)
    assert first < 60 and all(knew[first:])
    began = next(k for k, force in enumerate(forces) if force != AT_REST)
    assert first < began < first + 60
    assert told[0][3] == pytest.approx((0.3, 20.0))
    for off_m, off_deg in (off for *_, off, _ in told[15 * 20 :]):
        assert off_m < 0.03 and off_deg < 2.0
    where = one.state.whereabouts
    off_m = np.hypot(where.x_m - one.body.at[0], where.y_m - one.body.at[1])  # at one moment: how honest, others ask
    assert off_m < 4.0 * where.place_sigma_m < 0.03
    assert where.yaw_deg == pytest.approx(np.degrees(one.body.at[2]), abs=4.0 * where.yaw_sigma_deg)
    assert where.yaw_sigma_deg < 1.0


def test_without_landmarks_it_only_looks_around() -> None:
    one, ways = InTank(fleet()), set()
    one.sees_tags = False
    for _ in range(14 * 20):
        one.step()
        assert one.wrench == AT_REST and one.outputs.set_point.depth_m == DEPTH_M
        ways.add(one.agent.target_search.pointing.goal_us)
    assert len(ways) >= 5 and np.ptp([pan for pan, _ in ways]) > 1000  # 90 degrees
    assert one.state.whereabouts is None
    one.run(17.0, 5 * STEP_NS)
    assert one.outputs.set_point.depth_m == SURFACE_M  # nothing will be seen from here
    one.sees_tags = True
    assert one.until(lambda: not one.swimmer.lost, 8.0)
    assert one.outputs.set_point.depth_m == DEPTH_M


@pytest.mark.parametrize("how", ["disarmed", "failsafe", "silent"])
def test_no_force_while_the_module_may_not_turn_motors(how) -> None:
    one = InTank(fleet(), ASTRAY)
    one.armed, one.ladder = how != "disarmed", 1 if how == "failsafe" else 0
    for _ in range(40):
        one.step()
        if how != "silent":
            assert one.wrench == AT_REST
    assert not one.swimmer.lost  # looking and knowing go on
    if how != "silent":
        one.armed, one.ladder = True, 0
        one.step()
        assert one.wrench != AT_REST
        return
    assert one.wrench != AT_REST
    for _ in range(12):
        one.now_ns += STEP_NS
        outputs = one.agent.step(replace(one.inputs, telemetry=()), one.now_ns)
    assert (*outputs.set_point.force_n, outputs.set_point.yaw_moment_nm) == AT_REST


# --- lost -------------------------------------------------------------------------------------------------------


def test_it_brakes_though_it_is_lost_and_tells_the_others_where_it_may_be() -> None:
    """Landmarks are gone while it swims at full speed: it has stopped before it is lost, and nearly stays there."""
    goto = Goto(x_m=2.4, y_m=1.0, yaw_deg=0.0)
    one = FleetInTank(fleet_of([(0.7, 1.0, 0.0), (0.6, 0.4, 0.0)], behaviour=goto), seed=4).robots["r01"]
    assert one.until(lambda: one.body.speed[0] > 0.2, 8.0)
    one.sees_tags = False
    assert one.until(lambda: one.swimmer.lost, 4.0)
    at_m, said = one.body.at[:2].copy(), []
    assert np.hypot(*one.body.speed[:2]) < 0.05
    for _ in range(3 * 20):
        said += one.step().said(NEAR)
    assert np.hypot(*(one.body.at[:2] - at_m)) < 0.10 and one.wrench == AT_REST
    off_m = np.hypot(said[-1].x_m - one.body.at[0], said[-1].y_m - one.body.at[1])
    sigma_m = np.sqrt(said[-1].cov[0] + said[-1].cov[3])
    assert len(said) >= 25 and sigma_m > LOST_M and off_m < 3.0 * sigma_m


def test_it_gives_way_while_its_camera_turns_back_from_landmarks() -> None:
    """It does not go on yet, but lets nobody drift into it."""
    one = FleetInTank(fleet_of([(1.0, 1.0, 0.0), (1.0, 0.6, 0.0)]), seed=4).robots["r01"]
    assert one.until(lambda: one.swimmer.phase in ("afloat", "ready"), 8.0)
    assert one.swimmer.phase == "afloat"
    word = presence(fleet="swim", src="r02", dst="r01", t_ns=one.now_ns, sent_ns=one.now_ns, x_m=1.0, y_m=0.7)
    letter = Heard(arrived_ns=one.now_ns, src="r02", payload=encode(word), topic="near")
    one.step(heard=[letter])
    _, left_n, _ = one.wrench
    assert left_n > 0.3
    assert one.swimmer.active.progress is None


def test_it_stands_still_while_it_looks_for_landmarks() -> None:
    """Turned to where landmarks should be, its camera would miss them."""
    slow = Navigation(limits=Limits(turn_deg_s=20.0))
    one = InTank(replace(fleet(behaviour=Turn(yaw_deg=170.0)), navigation=slow))
    assert one.until(lambda: abs(one.body.speed[2]) > 0.25, 6.0)
    one.sees_tags = False
    assert one.until(lambda: one.swimmer._at_landmarks, 4.0)
    one.run(0.6)
    assert abs(one.body.speed[2]) < 0.1 and one.off(0.0, 0.0, 170.0)[1] > 10.0
    assert 0.0 < pace(one.swimmer.localizer.at(one.now_ns)) < 1.0 or one.swimmer.lost


def test_lost_it_brakes_looks_around_surfaces_and_goes_on_when_it_is_found() -> None:
    one = InTank(fleet(), seed=5)
    assert one.until(lambda: not one.swimmer.lost, 3.0)
    one.run(1.0)
    one.sees_tags = False
    assert one.until(lambda: one.swimmer.lost, 6.0)
    since_ns, ways = one.now_ns, set()
    while one.outputs.set_point.depth_m == DEPTH_M:
        one.step(8 * STEP_NS)  # a busy computer; what it does does not hang on how often
        assert one.wrench == AT_REST or one.now_ns - since_ns < BRAKES_NS
        ways.add(one.agent.target_search.pointing.goal_us)
    assert (
        one.wrench == AT_REST
        and 30.0 < (one.now_ns - since_ns) * 1e-9 < 30.9
        and one.outputs.set_point.depth_m == SURFACE_M
    )
    assert len(ways) > 6
    one.body.at += (0.30, -0.15, np.radians(150.0))  # somebody gave it a push
    one.sees_tags = True
    assert one.until(lambda: not one.swimmer.lost, 8.0)
    assert one.outputs.set_point.depth_m == DEPTH_M
    assert one.until(lambda: one.wrench != AT_REST, 3.0)
    here = one.swimmer.localizer.at(one.now_ns)
    assert np.hypot(*np.subtract(here.pose[:2], one.body.at[:2])) < 0.03
    assert one.until(lambda: one.off(*THERE) < (0.03, 180.0) and one.off(*THERE)[1] < 2.0, 10.0)


def test_of_times_long_past_it_does_not_count_up_to_now_again_and_again() -> None:
    """Nothing happens any more: what is asked for is a second away, and no more."""
    one = InTank(fleet())
    assert one.until(lambda: not one.swimmer.lost, 3.0)
    one.sees_tags = False
    assert one.until(lambda: one.swimmer.lost, 6.0)
    ring = one.swimmer.localizer._ring
    for _ in range(15):
        one.step(8 * STEP_NS)
        assert one.now_ns - ring.newest.t_ns <= 2 * RING_NS
    assert ring.at(one.now_ns) == ring.at(one.now_ns)


def test_a_floor_that_is_followed_keeps_it_from_being_lost() -> None:
    lost = []
    for floor in (True, False):
        one = InTank(fleet(look=Look(tilt_deg=-40.0)))
        one.sees_floor = floor
        assert one.until(lambda one=one: not one.swimmer.lost, 4.0)
        one.run(1.0)
        one.sees_tags = False
        one.run(5.0)
        lost.append(one.swimmer.lost)
    assert lost == [False, True]


def test_after_a_sweep_it_waits_for_sharp_frames_before_it_glances() -> None:
    one = InTank(fleet(look=Look(pan_deg=20.0)))
    assert one.until(lambda: not one.swimmer.lost, 4.0)
    one.run(2.0)
    one.sees_tags, swimmer, at_us = False, one.swimmer, one.agent.target_search.pointing.goal_us
    for _ in range(60):
        swimmer._swept_ns = one.now_ns  # as if one sweep followed the other
        one.step()
    assert one.agent.target_search.pointing.goal_us == at_us and not within(
        swimmer.localizer.at(one.now_ns), UNSURE_M, UNSURE_DEG
    )
    one.run(ARRIVED_NS * 1e-9 - 0.05)
    assert one.agent.target_search.pointing.goal_us == at_us
    one.run(0.1)
    assert one.agent.target_search.pointing.goal_us != at_us


def test_no_sweep_begins_while_it_swims_fast() -> None:
    one = InTank(fleet(), ASTRAY)
    assert not calm(one.swimmer.localizer.at(one.now_ns))  # it does not even know where it is
    assert one.until(lambda: not one.swimmer.lost, 4.0)
    slowly, fast = [], []
    for _ in range(120):
        one.step()
        rows = fast if np.hypot(*one.body.speed[:2]) > 0.2 else slowly
        rows.append(calm(one.swimmer.localizer.at(one.now_ns)))
    assert fast and not any(fast) and slowly[-1]


# --- what the file says ------------------------------------------------------------------------------------------


def test_goto_is_swum() -> None:
    one = InTank(fleet(behaviour=Goto(x_m=1.3, y_m=0.8, yaw_deg=60.0, depth_m=0.35)))
    one.run(7.0)
    off_m, off_deg = one.off(1.3, 0.8, 60.0)
    assert off_m < 0.03 and off_deg < 2.0 and one.outputs.set_point.depth_m == 0.35


def test_turn_is_turned_on_the_spot() -> None:
    one = InTank(fleet(behaviour=Turn(yaw_deg=100.0)))
    one.run(6.0)
    off_m, off_deg = one.off(POSE.x_m, POSE.y_m, 100.0)
    assert off_m < 0.03 and off_deg < 2.0


def test_orbit_goes_round_and_faces_the_middle() -> None:
    middle = np.array([1.3, 0.9])
    one = InTank(fleet(pose=replace(POSE, yaw_deg=0.0), behaviour=Orbit(x_m=1.3, y_m=0.9, radius_m=0.3)))
    assert one.until(lambda: one.swimmer.active.progress is not None, 8.0)
    one.run(4.0)
    arm = one.body.at[:2] - middle
    assert np.hypot(*arm) == pytest.approx(0.3, abs=0.03)
    assert one.off(*one.body.at[:2], np.degrees(np.arctan2(*-arm[::-1])))[1] < 6.0
    gone = np.arctan2(arm[1], arm[0]) % (2 * np.pi) - np.pi  # it began on the far side
    assert gone == pytest.approx(4.0 * 0.1 / 0.3, abs=0.1)  # 0.1 m/s, from when it began


def test_a_steady_pull_does_not_keep_it_from_what_it_is_told() -> None:
    """A tether in a current, say: what it thrusts against that is learnt, and no doubt any more."""
    one = InTank(fleet(behaviour=Goto(x_m=1.9, y_m=1.2, yaw_deg=40.0)), seed=3)
    for _ in range(400):
        one.step(pull=(2.0, -1.0, 0.0))
    assert one.swimmer.under_way and one.off(1.9, 1.2, 40.0)[0] < 0.03


def test_an_orbit_is_no_faster_than_the_robot_is_told_to_be() -> None:
    one = InTank(fleet(pose=replace(POSE, yaw_deg=0.0), behaviour=Orbit(x_m=1.3, y_m=0.9, radius_m=0.3)))
    one.swimmer.limit_speed(0.05)
    assert one.until(lambda: one.swimmer.active.progress is not None, 8.0)
    one.run(2.0)
    speeds, radii = [], []
    for _ in range(160):
        one.step()
        speeds.append(np.hypot(*one.body.speed[:2]))
        radii.append(np.hypot(*(one.body.at[:2] - (1.3, 0.9))))
    assert 0.03 < np.median(speeds) < 0.05 and max(speeds) < 0.06
    assert max(abs(radius - 0.3) for radius in radii) < 0.03


def test_it_keeps_clear_of_a_target_that_it_does_not_watch() -> None:
    of = fleet(behaviour=Goto(x_m=1.9, y_m=0.9, yaw_deg=40.0))
    one = InTank(replace(of, target={"ball": Target(radius_m=0.07), "stone": Target(radius_m=0.07)}))
    stone = 1.45, 0.9, 0.3
    one.agent.targets["stone"].measure(Prior(stone, (1e-4, 0.0, 0.0, 1e-4, 0.0, 1e-4), START_NS))
    one.agent.targets["stone"].iterate(START_NS)
    assert one.agent.measuring.watched == "ball"
    least_m = 9.0
    for _ in range(300):
        one.step()
        least_m = min(least_m, float(np.hypot(*(one.body.at[:2] - stone[:2]))))
    assert 0.33 < least_m < 0.45 and one.agent.measuring.watched == "ball"


def test_it_says_that_it_does_not_get_where_it_is_told_to() -> None:
    one = FleetInTank(fleet_of([(0.7, 1.0, 0.0), (2.0, 1.0, 0.0)]), seed=1)
    one.goto("r01", (1.9, 1.0))  # where r02 holds
    for _ in range(200):
        one.step()
    r01 = one.robots["r01"].swimmer
    assert not r01.faults(one.robots["r01"].now_ns)
    for _ in range(320):
        one.step()
    (said,) = r01.faults(one.robots["r01"].now_ns)
    assert said.startswith("goto: no nearer to (1.90, 1.00) for 15 s: a robot, a target or a wall is in the way")
    one.goto("r01", (0.7, 1.0))
    for _ in range(200):
        one.step()
    assert not r01.faults(one.robots["r01"].now_ns)


def test_moored_robots_get_no_force_and_are_nowhere(swum) -> None:
    _, told = swum
    agent = Agent(fleet(swims=False), "r1", CALIBRATION, incarnation=7)
    for now_ns, inputs, *_ in told[:40]:
        outputs = agent.step(inputs, now_ns)
        assert b"whereabouts" not in encode(outputs)
        assert outputs.set_point.force_n == (0.0, 0.0) and outputs.set_point.yaw_moment_nm == 0.0
