"""Measurements of a ball on a few places, and what the consistency claim makes of them."""

import numpy as np
import pytest

from agent.experiments import ball_measurements as measurements
from agent.experiments.ball_measurements import rotation_of
from agent.experiments.claim import Share
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from tests.bench.bench_consistency import CUES, summary

BALL_M = (0.3, 0.3, 0.07)


def test_figures_are_of_places_that_give_a_measurement():
    def place(distance_m, nees, range_mm):
        return {
            "distance_m": distance_m,
            **{cue: {"nees": nees, "error_mm": 3.0, "range_mm": range_mm} for cue in CUES},
        }

    hidden = {"distance_m": 0.26, **{cue: {"refused": "target seen in 3 of 30 frames"} for cue in CUES}}
    found = summary({"all": [place(0.3, 2.0, -1.0), place(1.0, 5.0, 4.0), hidden]})
    assert found["measured"] == Share(2, 3) and found["both_nees"] == 3.5
    assert found["focus_mm"] == pytest.approx(3.0) and found["size_near_mm"] == 1.0 and found["size_far_mm"] == 4.0
    assert found["both_middle_mm"] is None
    assert summary({"all": [hidden]})["both_nees"] is None


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
