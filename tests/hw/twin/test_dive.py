"""A dive in lock-step: who moves when, by which pulses, and always the same."""

import os
import signal

import numpy as np
import pytest

from hw.camera.camera import CameraGone
from hw.twin.dive import SPAN, run_in_lock_step
from hw.twin.physics.body import matrix, quaternion
from hw.twin.physics.tank import TICK_NS
from tests.hw.twin.filled_history import START_NS, filled
from tests.hw.twin.stand_ins import pid


def test_the_crew_holds_a_robot_until_it_is_armed(plunge):
    dive = plunge()
    start = dive.states["position_m"].copy()
    run_in_lock_step(dive, 10)
    np.testing.assert_array_equal(dive.states["position_m"], start)
    run_in_lock_step(dive, 60)
    assert np.all(dive.states["held"] == 0)
    assert np.all(dive.states["position_m"][:, 2] > start[:, 2] + 0.01)


def test_servo_pulses_turn_the_gimbal(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 100)
    pan, tilt = dive.states["shaft_deg"][0, :2]
    assert pan == pytest.approx(200 * 0.09, abs=1.7)  # zero, scale and play
    assert tilt == pytest.approx(-100 * 0.09, abs=1.7)


def test_the_same_seed_gives_the_same_bytes(plunge):
    ends = []
    for seed in (4, 4, 5):
        dive = plunge(seed=seed)
        dive.push("r2", (0.0, 0.0, -8.0), (0.13, 0.13, 0.0), 0.3)
        run_in_lock_step(dive, 150)
        ends.append(dive.states.tobytes())
        for board in dive.boards:
            board.close()
    assert ends[0] == ends[1] != ends[2]


def test_lock_step_names_who_is_silent(plunge, monkeypatch):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 3)
    os.kill(pid(dive.boards[0]), signal.SIGSTOP)
    monkeypatch.setattr("hw.twin.dive.LOCK_STEP_S", 0.2)
    with pytest.raises(TimeoutError, match="firmware of r1"):
        run_in_lock_step(dive, 3)


# --- history ---
# Poses between ticks, and those that are not kept.


def test_poses_are_interpolated_between_ticks():
    pose, other = filled(20).at(START_NS + 12 * TICK_NS + TICK_NS // 4)
    np.testing.assert_allclose(pose.position_m, (0.01225, 0.2, 0.1))
    np.testing.assert_allclose(pose.rotation, matrix(quaternion(0, 0, 0.1225)), atol=1e-7)
    assert pose.pan_deg == pytest.approx(1.225)
    np.testing.assert_allclose(other.position_m, (1.0, 0.8, 0.1))


def test_a_pose_of_the_future_or_the_forgotten_past_is_refused():
    history = filled(SPAN + 50)
    assert history.at(START_NS + 50 * TICK_NS)
    assert history.at(history.newest_ns)
    for t_ns in (START_NS + 50 * TICK_NS - 1, history.newest_ns + 1):
        with pytest.raises(CameraGone):
            history.at(t_ns)
