"""Measurements of robots that swim, in small: what is drawn, the filter that is the bound, and what is summed up."""

import math

import numpy as np
import pytest

from agent.capabilities.swim.landmarks import markers
from agent.capabilities.swim.plane_odometry import odometry
from agent.capabilities.swim.projection import view
from agent.capabilities.swim.tag_fix import Map, priors, tag_fix, whole
from agent.core.attitude import Attitude
from agent.core.config import Pose
from agent.core.linear_algebra import full, plus, times, wrap
from agent.core.messages import Estimate
from agent.core.ranging.fix import Fix
from agent.experiments.claim import Quantile, Share
from agent.experiments.navigation import around_ball, basin, manoeuvres, search
from agent.experiments.navigation.around_ball import crossing, free_place, target
from agent.experiments.navigation.basin import CAMERA, PlanarBodies
from agent.experiments.navigation.joint_filter import JointFilter
from agent.experiments.navigation.manoeuvres import ORBIT_M, ORBIT_M_S, gone_round, goto, off_circle, settled_s
from agent.experiments.navigation.swimmers import DrawnCamera, Swimmers
from hw.twin.dive import RobotPose

S = 1_000_000_000
LEVEL = Attitude(basin.DEPTH_M, 0.0, 0.0)
SURE = (1e-18, 0.0, 0.0, 1e-18, 0.0, 1e-18)
RANDOM, STAYS = (4e-6, 1e-6, 0.0, 9e-6, 0.0, 1e-6), (2e-6, 0.0, 0.0, 1e-6, 0.0, 3e-6)


def pose_at(x, y, psi, tilt_deg) -> RobotPose:
    c, s = math.cos(psi), math.sin(psi)
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return RobotPose(np.array([x, y, basin.TANK.surface_m - basin.DEPTH_M]), rotation, 0.0, tilt_deg)


def one_robot(seed=0):
    return basin.fleet({"r1": basin.robot("r1", Pose(x_m=1.0, y_m=1.0, yaw_deg=0.0))}, seed)


# --- what is drawn ----------------------------------------------------------------------------------------------


def test_drawn_tags_are_as_wrong_as_the_kernel_believes() -> None:
    """Other surveys, places and ways to look: the twin's geometry there, the kernel's here."""
    nees = []
    for seed in range(16):
        fleet, rng = one_robot(seed), np.random.default_rng(seed)
        camera, known = DrawnCamera(fleet, "r1", CAMERA), Map(fleet.landmarks, markers(fleet.landmarks))
        for _ in range(4):
            x, y, psi = rng.uniform((0.6, 0.6, -3.0), (2.4, 1.4, 3.0))
            tags, _ = camera.expose(pose_at(x, y, psi, -40.0), 0)
            of = view(CAMERA, fleet.body, basin.TANK.surface_m, None)
            level = Attitude(basin.DEPTH_M + rng.normal(0.0, 7e-4), *rng.normal(0.0, 0.1, 2))
            gimbal = rng.normal((0.0, -40.0), 0.02)
            fix = tag_fix(of, priors(level, gimbal, 0.0, turning=False), known, tags.tags, (x + 0.02, y, psi))
            if tags.tags:
                e = np.array([fix.theta[0] - x, fix.theta[1] - y, wrap(fix.theta[2] - psi)])
                nees.append(e @ np.linalg.solve(full(fix.covariance), e) / 3.0)
    assert len(nees) > 35 and 0.7 < np.mean(nees) < 1.3


def test_drawn_points_say_how_it_moved() -> None:
    fleet = one_robot()
    camera = DrawnCamera(fleet, "r1", CAMERA)
    of = view(CAMERA, fleet.body, basin.TANK.surface_m, None)
    at = whole((0.0, 0.0, 0.0), priors(LEVEL, (0.0, -40.0), 0.0, turning=False))
    camera.expose(pose_at(1.0, 1.0, 0.5, -40.0), S)
    _, flow = camera.expose(pose_at(1.0 + 0.03 * math.cos(0.5), 1.0 + 0.03 * math.sin(0.5), 0.52, -40.0), 2 * S)
    water_m = (*basin.TANK.size_m[:2], basin.TANK.surface_m)
    at = whole((1.0, 1.0, 0.5), priors(LEVEL, (0.0, -40.0), 0.0, turning=False))
    moved = odometry(of, at, at, flow.pairs, water_m, 0.0)
    assert flow.since_ns == S and moved.pose == pytest.approx((0.03, 0.0, 0.02), abs=1e-3)
    camera.interrupt()
    assert camera.expose(pose_at(1.0, 1.0, 0.5, -40.0), 3 * S)[1] is None


# --- the bound --------------------------------------------------------------------------------------------------


def sample(at_m) -> Fix:
    return Fix(at_m, RANDOM, STAYS)


def test_samples_of_one_robot_share_what_stays_and_those_of_two_do_not() -> None:
    for robots in (1, 2):
        joint = JointFilter(robots)
        for i in range(robots):
            joint.begin(i, S, (float(i), 0.0, 0.0), SURE)
            for _ in range(5):
                joint.add_sample(i, sample((1.0, 1.0, 0.1)), (0.0,) * 6)
        at, covariance = joint.target
        expected = np.array(full(plus(times(1 / 5, RANDOM), STAYS))) / robots
        np.testing.assert_allclose(covariance, expected, rtol=1e-5, atol=1e-11)
        np.testing.assert_allclose(at, (1.0, 1.0, 0.1), atol=1e-6)


def test_who_does_not_know_its_yaw_learns_it_of_a_target_that_others_know() -> None:
    """J P J' + R of the first sample; after the other's, all of what they share."""
    joint, unsure = JointFilter(2), (1e-6, 0.0, 0.0, 1e-6, 0.0, 4e-4)
    joint.begin(0, S, (0.0, 0.0, 0.0), unsure)
    joint.begin(1, S, (1.0, 0.5, 0.0), SURE)
    joint.add_sample(0, sample((1.0, 1.0, 0.1)), (0.0,) * 6)
    J = np.array([[1.0, 0.0, -1.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]])
    alone = J @ full(unsure) @ J.T + full(plus(RANDOM, STAYS))
    np.testing.assert_allclose(joint.target[1], alone, rtol=1e-4, atol=1e-9)
    joint.add_sample(1, sample((1.0, 1.0, 0.1)), (0.0,) * 6)
    sure = np.array(full(plus(RANDOM, STAYS)))
    np.testing.assert_allclose(
        joint.target[1], np.linalg.inv(np.linalg.inv(alone) + np.linalg.inv(sure)), rtol=1e-3, atol=1e-10
    )
    assert math.sqrt(joint.P[2, 2]) < 0.3 * 0.02


def test_it_coasts_and_remembers_its_key_frame() -> None:
    joint = JointFilter(1)
    joint.begin(0, S, (0.0, 0.0, 0.3), SURE)
    joint.x[3:5] = 0.02, 0.01
    joint.keep_key(0, S)
    joint.predict(0, 2 * S)
    x, y, psi = joint.pose(0)
    assert 0.01 < x < 0.02 and y == pytest.approx(0.5 * x) and psi == pytest.approx(0.3)
    before = joint.P[0, 0]
    joint.add_flow(
        0, S, (math.hypot(x, y) * math.cos(math.atan2(y, x) - 0.3), 0.0, 0.0), (4e-6, 0.0, 0.0, 4e-6, 0.0, 1e-6)
    )
    assert joint.P[0, 0] < 0.1 * before
    joint.add_flow(
        0, S - 1, (9.0, 9.0, 0.0), (1e-12, 0.0, 0.0, 1e-12, 0.0, 1e-12)
    )  # of a key frame that it does not have
    assert joint.pose(0)[0] == pytest.approx(x, abs=5e-3)


# --- what is swum -----------------------------------------------------------------------------------------------


def test_when_it_settles_and_how_far_it_is_off_an_orbit() -> None:
    t = np.arange(1.0, 6.0)
    assert settled_s(t, np.array([3.0, 0.5, 2.0, 0.5, 0.5]), 1.0) == 4.0
    assert settled_s(t, np.array([3.0, 0.5, 0.5, 0.5, 2.0]), 1.0) is None and settled_s(t, 0.0 * t, 1.0) == 0.0
    t = np.linspace(0.0, 20.0, 200)
    way = 0.7 + ORBIT_M_S / ORBIT_M * t
    late = np.column_stack([t, 1.0 + ORBIT_M * np.cos(way - 0.1), 2.0 + ORBIT_M * np.sin(way - 0.1), way])
    assert off_circle(late, (1.0, 2.0)).max() < 1e-9 and gone_round(late, (1.0, 2.0)) == pytest.approx(1.0, abs=0.01)
    waits = late.copy()
    waits[100:, 1:3] = late[100, 1:3]
    assert off_circle(waits, (1.0, 2.0)).max() < 1e-9 and gone_round(waits, (1.0, 2.0)) == pytest.approx(0.5, abs=0.05)
    late[:, 1] += 0.01
    assert off_circle(late, (1.0, 2.0)).mean() == pytest.approx(0.0064, abs=0.001)


def test_what_is_said_in_one_step_is_heard_in_the_next_unless_it_is_lost() -> None:
    fleet = basin.linked([Pose(x_m=x, y_m=1.0, yaw_deg=0.0) for x in (1.0, 2.0)], 0)
    swimmers = Swimmers(fleet, PlanarBodies(fleet))
    assert swimmers.least_apart_m() == 1.0
    for _ in swimmers.each_step(0.25):
        pass
    assert {heard.src for heard in swimmers.inputs["r1"].heard} <= {"r2"}
    said = [each for each in swimmers.outputs["r2"].says if isinstance(each, Estimate)]
    swimmers.step()
    assert [heard.src for heard in swimmers.inputs["r1"].heard] == ["r2"] * len(said)
    swimmers.lost = lambda letter: True
    swimmers.step()
    assert not any(swimmers.inputs["r1"].heard for _ in swimmers.each_step(1.0))


def test_robots_that_cross_get_one_goal_after_the_other() -> None:
    rng, taken = np.random.default_rng(0), []
    for _ in range(10):
        taken.append(free_place(rng, taken))
    assert min(math.dist(a, b) for i, a in enumerate(taken) for b in taken[:i]) >= around_ball.APART_M
    assert crossing(3, robots=2, seconds=2.0) == crossing(3, robots=2, seconds=2.0)
    row = crossing(3, robots=2, seconds=12.0, loss=0.3)
    assert 0 < row["reached"] <= row["tried"] and around_ball.RINGS_M < row["least_m"] < 2.0


def test_half_a_metre_on_the_twin_s_body_under_the_board_s_firmware(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(manoeuvres, "GOTO_S", 7.0)
    row = goto(100)
    assert 1.5 < row["s"] < 6.0 and row["overshoot_mm"] < 60.0


def test_the_bound_knows_the_ball_as_well_as_the_robots_that_measured_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(around_ball, "ROBOTS", 2)
    row = target(1, seconds=18.0)
    assert row["silent"] == 0 and row["samples"] >= 4
    assert row["bound_mm"] < 6.0 and max(row["error_mm"]) < 1.5 * row["bound_mm"]


# --- what is summed up ------------------------------------------------------------------------------------------


def test_what_manoeuvres_come_to() -> None:
    found = manoeuvres.summary(
        {
            "hold": [{"rms_mm": 3.0, "yaw_rms_deg": 0.3}, {"rms_mm": 4.0, "yaw_rms_deg": None}],
            "turn": [{"s": 2.0}, {"s": None}],
        }
    )
    assert found == {
        "hold_rms_mm": pytest.approx(math.sqrt(12.5)),
        "hold_yaw_rms_deg": None,
        "turn_s": Quantile([2.0, None], 95.0),
    }


def test_what_robots_around_a_ball_come_to() -> None:
    known = {"silent": 0, "doubted": False, "error_mm": [1.1, 1.1], "nees": [0.5, 1.5], "bound_mm": 1.0}
    found = around_ball.summary({"target": [known, known]})
    assert found["target_ratio_to_bound"] == pytest.approx(1.1) and found["target_nees"] == 1.0
    silent = {"silent": 1, "doubted": False, "error_mm": [], "nees": [], "bound_mm": 1.0}
    assert around_ball.summary({"target": [known, silent]})["target_ratio_to_bound"] is None
    apart = [{"least_m": 0.33, "tried": 3, "reached": 2}, {"least_m": 0.4, "tried": 1, "reached": 1}]
    assert around_ball.summary({"separation": apart}) == {
        "separation_least_m": Quantile([0.33, 0.4], 0.0),
        "separation_keep": Share(1, 2),
        "separation_reached": 75.0,  # a number: goals of one dive are no trials of their own
    }


def test_what_searchers_come_to() -> None:
    alone, three = (
        {"s": None, "least_m": None, "told": 0, "robots": 1},
        {"s": 9.0, "least_m": 0.5, "told": 2, "robots": 3},
    )
    assert search.summary({"three": [three], "alone": [alone]}) == {
        "three_told": pytest.approx(66.67, abs=0.01),
        "three_s": Quantile([9.0], 95.0),
        "alone_s": Quantile([None], 95.0),
        "three_least_m": Quantile([0.5], 0.0),
        "three_keep": Share(1, 1),
    }


@pytest.mark.parametrize("claim", [manoeuvres.CLAIM, around_ball.CLAIM, search.CLAIM])
def test_figures_are_those_of_all_cases(claim) -> None:
    """Each case's figures begin with its name."""
    of = {max((case for case in claim.cases if figure.key.startswith(case)), key=len) for figure in claim.figures}
    assert of == set(claim.cases) and len({figure.key for figure in claim.figures}) == len(claim.figures)
