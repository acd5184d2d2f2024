"""Battery, slew and weight: what stands between the wrench that a law asks for and the pulses."""

from __future__ import annotations

import importlib

import pytest

from hw.firmware import thrust, wire
from tests.hw.firmware.nominal_plant import AIR_PA

# Largest thrust of a T200 forward and in reverse, N, by battery voltage: the maker's workbook of September 2019.
T200_N = {12: (36.4, 28.6), 14: (44.4, 34.5), 16: (51.4, 39.9), 18: (59.0, 45.0), 20: (65.9, 49.4)}


@pytest.mark.parametrize("volt", T200_N)
def test_thrust_follows_the_battery_as_the_makers_table_has_it(volt):
    low, high = thrust.BATTERY_RANGE
    for k in range(2):
        if low <= volt / 14 <= high:
            assert thrust.full_n(T200_N[14][k], volt / 14) == pytest.approx(T200_N[volt][k], rel=0.04)
    assert thrust.full_n(10.0, 0.0) == thrust.full_n(10.0, low), "a probe that reads nothing does not stop the robot"


@pytest.mark.parametrize("force_n", [-6.0, -0.5, 0.5, 3.0, 7.9])
def test_a_weaker_battery_needs_longer_pulses(force_n):
    strong, weak = (thrust.pulse_us(force_n, 1500, thrust.full_n(10.0, ratio)) - 1500 for ratio in (1.0, 0.85))
    assert abs(weak) > abs(strong)


def test_slew_is_obeyed_and_the_law_is_told():
    forces, realised = [0.0] * 8, [0.0] * 3
    for cycle in range(1, 10):
        before = list(forces)
        assert not thrust.central([24.0, 0.0, 0.0], 0.0, 10.0, 2.0, forces, realised)
        assert max(abs(f - b) for f, b in zip(forces, before, strict=True)) <= 2.0 + 1e-12
        assert realised[0] == pytest.approx(min(24.0, 8.0 * cycle))


@pytest.fixture
def module(monkeypatch):
    """A control module with a tare, 30 cm deep, armed."""
    monkeypatch.syspath_prepend(str(importlib.import_module("hw.firmware").__path__[0]))
    motor_control, parameters = importlib.import_module("motor_control"), importlib.import_module("parameters")

    def make(tilt_m: float = 0.0, **flash):
        made = motor_control.Control()
        made.configure(parameters.from_flash(flash))
        made.plane.tare_pa = [AIR_PA] * 4
        made.plane.set_pa = [AIR_PA + wire.PA_PER_M * (0.3 + sign * tilt_m) for sign in (1, 1, -1, -1)]
        made.sense(made.plane.set_pa, 15, 14800, 0, 10_000)
        made.set_point.age_us, made.set_point.ttl_us = 0, 500_000
        made.set_point.depth_m, made.set_point.tilt_rad = made.plane.depth_m, [made.plane.roll_rad, 0.0]
        made.arm()
        return made

    return make


@pytest.mark.parametrize("tilt_m", [0.0, 0.05])
def test_net_weight_is_carried_from_the_first_cycle_and_is_none_of_the_laws(module, tilt_m):
    still, heavy = module(tilt_m, slew_N=100), module(tilt_m, slew_N=100, net_weight_N=4.0)
    for robot in (still, heavy):
        for _ in range(50):
            robot.set_point.age_us = 0
            robot.sense(robot.plane.set_pa, 15, 14800, 0, 10_000)
            robot.act(10_000)
    assert heavy.law.disturbance(0) == pytest.approx(still.law.disturbance(0), abs=1e-9)
    lift = sum(heavy._forces_n[:4]) - sum(still._forces_n[:4])
    assert lift == pytest.approx(4.0 / (1.0 - (tilt_m / 0.13) ** 2) ** 0.5)
