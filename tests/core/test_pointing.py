"""Pointing and search as state machines: the gimbal's play is taken from one side, and the search sees both sides."""

import math

import numpy as np
import pytest

from agent.core.ranging.pointing import (
    HIGHEST_US,
    KEEP_NS,
    LAG_SIGMA_S,
    LOWEST_US,
    PLAY_US,
    SERVO_LAG_S,
    SLEW_US_PER_S,
    THERE_US,
    Pointing,
    Search,
    ServoModel,
    reachable,
)

S = 1_000_000_000


def test_final_approach_always_comes_from_below() -> None:
    pointing, now = Pointing(), 0
    for goal in ((1500, 1500), (1700, 1400), (1600, 1450)):
        pointing.aim(goal, now)
        assert pointing.servos_us(now) == (goal[0] - PLAY_US, goal[1] - PLAY_US)
        assert not pointing.steady(now)
        now += 3 * S
        assert pointing.servos_us(now) == goal
        assert pointing.steady(now)
    before = pointing.steady_from_ns
    pointing.aim((1600, 1450), now)
    assert pointing.steady_from_ns == before


def test_no_pulse_is_asked_for_that_a_board_refuses() -> None:
    for goal in ((480, 500), (500, 979), (2500, 1500), (2600, 2501)):
        pointing = Pointing()
        pointing.aim((1500, 1500), 0)
        pointing.aim(reachable(goal), 10**9)
        for t_ns in range(10**9, 4 * 10**9, 10**8):
            assert all(LOWEST_US <= pulse <= HIGHEST_US for pulse in pointing.servos_us(t_ns))
    assert reachable((1234, 1400)) == (1234, 1400)


def test_search_waits_for_the_gimbal_and_visits_both_sides() -> None:
    search, now, seen = Search(), 0, []
    assert search.offset_deg(steady=False, now_ns=100 * S) == (0.0, 0.0)
    for _ in range(40):
        seen.append(search.offset_deg(steady=True, now_ns=now))
        now += S
    assert min(p for p, _ in seen) < -30 < 30 < max(p for p, _ in seen)
    search.reset()
    assert search.offset_deg(steady=True, now_ns=now) == (0.0, 0.0)


# --- servo path ---
# Servos that are told another angle at each step, against a motor that is integrated in small ones.

STEP_NS, FINE_S = 50_000_000, 5e-5
START_NS = 10**18


def test_it_is_a_lagging_motor_that_turns_no_faster_than_it_can() -> None:
    told = np.concatenate([[1500.0, 1500.0, 2100.0, 2100.0, 2100.0], 2100.0 - 20.0 * np.arange(12), [1400.0] * 6])
    path, motor, t, jumps = ServoModel(), 1500.0, 0, False
    path.begin((1500.0, 1500.0))
    for k, us in enumerate(told):
        path.add(START_NS + k * STEP_NS, (float(us), 1500.0))
        for _ in range(5):
            for _ in range(round(1e-9 * STEP_NS / 5 / FINE_S)):
                motor += FINE_S * np.clip((us - motor) / SERVO_LAG_S, -SLEW_US_PER_S, SLEW_US_PER_S)
            t += STEP_NS // 5
            stand, left_us = path.at(START_NS + t - 1), abs(us - motor)
            assert stand.us == (pytest.approx(motor, abs=0.3), 1500.0)
            jumps = left_us > THERE_US and (jumps or left_us > SLEW_US_PER_S * SERVO_LAG_S)
            sigma_us = math.inf if jumps else LAG_SIGMA_S / SERVO_LAG_S * left_us
            assert stand.sigma_us == pytest.approx(sigma_us, abs=0.2), "nobody knows how fast it can"


def test_it_knows_the_last_seconds() -> None:
    path = ServoModel()
    assert path.at(START_NS) is None
    path.begin((1500, 1500))
    assert path.at(START_NS) is None, "nothing was told yet"
    for k in range(200):
        path.add(START_NS + k * STEP_NS, (1500 + k, 1500))
    newest_ns = START_NS + 199 * STEP_NS
    assert path.at(newest_ns - KEEP_NS).told_ns == newest_ns - KEEP_NS
    assert path.at(newest_ns - KEEP_NS - 1) is None


def test_one_that_turns_on_after_a_jump_is_known_again() -> None:
    path, known_from_ns = ServoModel(), None
    path.begin((1500.0, 1500.0))
    for k in range(60):
        path.add(START_NS + k * STEP_NS, (2000.0 + 33.0 * k, 1500.0))  # 60 degrees a second: never where it is told
        stand = path.at(START_NS + k * STEP_NS + STEP_NS // 2)
        if math.isinf(stand.sigma_us):
            known_from_ns = None
        elif known_from_ns is None:
            known_from_ns = k * STEP_NS
    assert 300_000_000 < known_from_ns < 900_000_000
