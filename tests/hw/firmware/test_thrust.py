"""Battery, slew and weight: what stands between the wrench that a law asks for and the pulses."""

from __future__ import annotations

import importlib
import math

import numpy as np
import pytest
from msgspec.structs import replace

from hw.firmware import thrust, wire
from hw.twin.physics.body import euler_rad, matrix
from hw.twin.physics.forces import RING_M, RING_RAD
from tests.hw.firmware.diving_robot import HOVER, diving_robot
from tests.hw.firmware.nominal_plant import AIR_PA

# Largest thrust of a T200 forward and in reverse, N, by battery voltage: the maker's workbook of September 2019.
T200_N = {12: (36.4, 28.6), 14: (44.4, 34.5), 16: (51.4, 39.9), 18: (59.0, 45.0), 20: (65.9, 49.4)}


def full_n(thrust_max_n: float, battery_ratio: float) -> float:
    return thrust.full_uN(round(1000 * thrust_max_n), int(battery_ratio * 16384)) * 1e-6


def pulse_us(force_n: float, full_n: float) -> int:
    """Of one thruster that rests at 1500 us."""
    pulses_us = [0] * 8
    thrust.pulses([round(force_n * 1e6)] * 8, [1500] * 8, round(full_n * 1e6), pulses_us)
    return pulses_us[0]


@pytest.mark.parametrize("volt", T200_N)
def test_thrust_follows_the_battery_as_the_makers_table_has_it(volt):
    for k in range(2):
        if 0.7 <= volt / 14 <= 1.3:
            assert full_n(T200_N[14][k], volt / 14) == pytest.approx(T200_N[volt][k], rel=0.04)
            assert full_n(10.0, volt / 14) == pytest.approx(10.0 * (volt / 14) ** 1.1, rel=1e-3)
    assert full_n(10.0, 0.0) == full_n(10.0, 0.7), "a probe that reads nothing does not stop the robot"


@pytest.mark.parametrize("force_n", [-6.0, -0.5, 0.5, 3.0, 7.9])
def test_a_weaker_battery_needs_longer_pulses(force_n):
    strong, weak = (pulse_us(force_n, full_n(10.0, ratio)) - 1500 for ratio in (1.0, 0.85))
    assert abs(weak) > abs(strong)


def test_slew_is_obeyed_and_the_law_is_told():
    forces, realised = [0] * 8, [0] * 3
    for cycle in range(1, 10):
        before = list(forces)
        assert not thrust.central([24_000_000, 0, 0], 10_000_000, 2_000_000, forces, realised)
        assert max(abs(f - b) for f, b in zip(forces, before, strict=True)) <= 2_000_000
        assert realised[0] == min(24_000_000, 8_000_000 * cycle)


@pytest.fixture
def module(monkeypatch):
    """A control module with a tare, 30 cm deep, armed."""
    monkeypatch.syspath_prepend(str(importlib.import_module("hw.firmware").__path__[0]))
    motor_control, parameters = importlib.import_module("motor_control"), importlib.import_module("parameters")

    def make(tilt_m: float = 0.0, **flash):
        made = motor_control.Control()
        made.configure(parameters.from_flash(flash))
        made.plane.tare_mPa = [round(1000 * AIR_PA)] * 4
        made.plane.set_mPa = [round(1000 * (AIR_PA + wire.PA_PER_M * (0.3 + s * tilt_m))) for s in (1, 1, -1, -1)]
        made.sense(made.plane.set_mPa, 15, 14800, 0, 10_000)
        made.set_point.age_us, made.set_point.ttl_us = 0, 500_000
        made.set_point.depth_100nm, made.set_point.tilt_100nrad = made.plane.depth_100nm, [made.plane.roll_100nrad, 0]
        made.arm()
        return made

    return make


@pytest.mark.parametrize("tilt_m", [0.0, 0.05])
def test_net_weight_is_carried_from_the_first_cycle_and_is_none_of_the_laws(module, tilt_m):
    still, heavy = module(tilt_m, slew_N=100), module(tilt_m, slew_N=100, net_weight_N=4.0)
    for robot in (still, heavy):
        for _ in range(50):
            robot.set_point.age_us = 0
            robot.sense(robot.plane.set_mPa, 15, 14800, 0, 10_000)
            robot.act(10_000)
    assert heavy.law.disturbance(0) == pytest.approx(still.law.disturbance(0), abs=1000)  # uN
    lift_n = (sum(heavy._forces_uN[:4]) - sum(still._forces_uN[:4])) * 1e-6
    assert lift_n == pytest.approx(4.0 / (1.0 - (tilt_m / 0.13) ** 2) ** 0.5, rel=1e-3)


# --- swimming dive ---
# A robot that nothing holds, in the twin's water: the force and the moment of a set-point push and turn it.


def root(linear, quadratic, force):
    """Speed at which a drag equals the force."""
    return (-linear + math.sqrt(linear**2 + 4 * quadratic * abs(force))) / (2 * quadratic) * math.copysign(1, force)


def flat_thrust(robot):
    """Forward, left and turning: what the four peripheral thrusters truly give, N, N, N m."""
    f = robot.dive.states["thrust_n"][0, 4:]
    return -np.sum(np.sin(RING_RAD) * f), np.sum(np.cos(RING_RAD) * f), RING_M * np.sum(f)


@pytest.fixture
def swimmer(tmp_path):
    with diving_robot(tmp_path, moored=False) as robot:
        robot.arm()
        yield robot


def test_it_swims_where_it_is_pushed_turns_where_it_is_turned_and_rests_where_nobody_speaks(swimmer):
    state, body = swimmer.dive.states[0], swimmer.dive.bodies[0]
    heading = matrix(state["quaternion"])[:, 0]
    start_m = state["position_m"].copy()
    swimmer.asks = replace(HOVER, force_n=(0.8, 0.0))
    swimmer.run(3.0)
    way_m = state["position_m"] - start_m
    forward_n, left_n, turning_nm = flat_thrust(swimmer)
    assert forward_n == pytest.approx(0.8, rel=0.3)  # the firmware's curve is not the thruster's
    assert abs(left_n) < 0.1 and abs(turning_nm) < 0.03
    # No yaw control holds it: thrusters that differ by 5 % turn it a little, so that it swims an arc.
    assert way_m @ heading > 0.9 * np.linalg.norm(way_m[:2]) > 0.15
    expected = root(body["linear_drag"][0], body["quadratic_drag"][0] + body["tether_drag"], forward_n)
    assert state["velocity_m_s"][0] == pytest.approx(expected, rel=0.1)
    assert abs(swimmer.depth_m - HOVER.depth_m) < 0.02 and swimmer.tilt_deg < 5.0

    swimmer.asks = replace(HOVER, yaw_moment_nm=0.25)
    swimmer.run(3.0)
    before_rad = euler_rad(state["quaternion"])[2]
    swimmer.run(0.5)
    turned_rad = (euler_rad(state["quaternion"])[2] - before_rad) % (2 * math.pi)
    _, _, turning_nm = flat_thrust(swimmer)
    assert turning_nm == pytest.approx(0.25, rel=0.3)
    expected = root(body["linear_drag"][5], body["quadratic_drag"][5], turning_nm)
    assert turned_rad / 0.5 == pytest.approx(expected, rel=0.15)

    swimmer.talks = False  # a silent host means no planar force
    swimmer.run(2.0)
    assert np.abs(swimmer.dive.states["thrust_n"][0, 4:]).max() < 0.01
