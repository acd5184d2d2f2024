"""The consistency experiment on a few measurements; the thousand of it are run by hand."""

import json

import numpy as np
import pytest

from agent.core.ranging.camera_model import Calibration, CameraFit, Eye, FocusFit
from agent.experiments import ball_measurements as measurements
from agent.experiments.ball_measurements import rotation_of
from agent.experiments.consistency import Result, cases_table, refusals, summary, table
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet

BALL_M = (0.3, 0.3, 0.07)


@pytest.fixture(scope="module")
def measured():
    return list(measurements.ball_measurements(7, 2, distance_m=0.5))


@pytest.mark.slow
def test_every_cue_finds_the_ball_and_says_how_well(measured):
    for one in measured:
        for cue in ("focus", "size", "both"):
            assert one[cue]["error_mm"] < 25 and 1 < one[cue]["sigma_mm"] < 15
            assert one[cue]["nees"] < 25
        assert one["size"]["range_sigma_mm"] < one["focus"]["range_sigma_mm"]
        assert one["both"]["range_sigma_mm"] <= one["size"]["range_sigma_mm"]
        assert abs(one["size"]["range_mm"]) < 3
    assert len({one["both"]["error_mm"] for one in measured}) == len(measured)


@pytest.mark.slow
def test_rows_and_table(measured):
    hidden = {"seed": 7, "distance_m": 0.26, "both": {"refused": "target seen in 3 of 30 frames"}}
    row = summary([*measured, hidden], "both", 0.25, 1.2)
    assert row["count"] == 3 and row["measured"] == 2
    assert row["nees"] == pytest.approx(np.mean([one["both"]["nees"] for one in measured]))
    assert summary([hidden], "both", 0.25, 0.4)["nees"] is None
    assert cases_table([row]).row_count == 1
    assert refusals([*measured, hidden]) == {"target seen in # of ## frames": 1}
    assert json.loads(json.dumps(row)) == row


def test_a_ball_that_overflows_shows_less_of_its_outline():
    peak = {"noise": 0.5, "width": 90.0, "lowest": 215, "highest": 720}
    worth = {"r2": 1.0, "rmse_m": 0.001, "held_out_rmse_m": 0.001}
    focus = FocusFit(u_inf_m=0.0, b_m=136.0, rho0=102.0, covariance=(0.0,) * 6, **peak, **worth)
    camera = CameraFit(width_px=640, height_px=480, f_px=1169.0, cx_px=319.5, cy_px=239.5)
    known = Calibration(robot="r1", made="", source="", focus=focus, camera=camera)
    ahead = ((0.0, 0.0, 1.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))  # looks along x
    arcs = [
        measurements.outline_deg(known, Eye((0.0, 0.0, 0.07), ahead, (0.0, 0.0, 0.07)), (d, 0.0, 0.07))
        for d in (0.60, 0.29, 0.25)
    ]
    # At 0.25 m the cone's half angle is 16.26 deg, its circle 341 px: it passes the rows 239.5 px from the middle at
    # 44.6 deg, the columns 319.5 px from it at 20.4 deg. At 0.29 m, 291 px, only the rows: at 55.5 deg.
    assert arcs == pytest.approx([360.0, 4 * 55.5, 4 * (44.6 - 20.4)], abs=3)


def test_places_are_in_the_tank_and_beliefs_about_right():
    rng, fleet = np.random.default_rng(0), load_fleet(shipped_fleet())
    for distance_m in (0.25, 1.2):
        case = measurements.draw_placement(fleet, BALL_M, distance_m, rng)
        x, y, z = case.position_m
        camera = np.array(case.position_m) + rotation_of(*case.roll_pitch_yaw_deg) @ fleet.body.camera_m
        assert np.linalg.norm(camera - BALL_M) == pytest.approx(distance_m)
        assert 0.1 <= x <= 1.4 and 0.1 <= y <= 1.1 and z > 0.05
        assert abs(case.pose.x_m - x) < 0.01 and abs(case.level[0] - (0.5 - z)) < 0.01
        assert np.abs(np.array(case.level[1:]) - case.roll_pitch_yaw_deg[:2]).max() < 1.0


@pytest.mark.parametrize(
    ("nees", "count", "honest"),
    [(3.0, 1000, True), (2.4, 1000, False), (3.6, 1000, False), (None, 1000, False), (3.6, 999, None)],
)
def test_a_mean_that_is_not_honest_is_said(nees, count, honest):
    rest = {"range_m": [0.25, 1.2], "count": 1, "measured": 1, "nees_median": 2.4, "error_rms_mm": 1, "sigma_mm": 1}
    cases = [{"cues": cue, "nees": value, **rest} for cue, value in (("both", 3.0), ("both", nees), ("size", 9.0))]
    result = Result(seed=0, count=count, cases=cases, measurements=[])
    assert result.honest is honest and result.failed is (honest is False)
    said = [str(part) for part in table(result).renderables]
    assert any("missed" in part for part in said) is result.failed
    assert any("no verdict" in part for part in said) is (honest is None)
