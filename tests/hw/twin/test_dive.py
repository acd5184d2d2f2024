"""A dive in lock-step: who moves when, by which pulses, and always the same."""

import os
import signal

import numpy as np
import pytest

from hw.twin.dive import run_in_lock_step
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
