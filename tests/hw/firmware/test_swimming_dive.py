"""A robot that nothing holds, in the twin's water: the force and the moment of a set-point push and turn it."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from hw.twin.physics.body import euler_rad, matrix
from hw.twin.physics.forces import RING_M, RING_RAD
from tests.hw.firmware.diving_robot import HOVER, diving_robot


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
