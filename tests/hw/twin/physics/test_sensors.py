"""Pressure sensors and servos of the twin."""

import math

import numpy as np
import pytest

from agent.core.config import Body, Tank
from hw.twin.physics.body import BODY, PLAY_DEG, SLEW_DEG_S, draw_body, motor_deg_after, quaternion, shaft_deg_after
from hw.twin.physics.sensors import ATMOSPHERE_PA, NOISE_M, PA_PER_M, STEP_PA, PressureSensors, water_pressure_pa
from hw.twin.physics.tank import STATE, STEP_S
from hw.twin.scene import Scene, Waves
from tests.hw.twin.stand_ins import boardless_dive

SURFACE_M = 0.5


def depths_m(roll=0.0, pitch=0.0, velocity=(0.0, 0.0, 0.0)):
    body, state, pressure_pa = np.zeros(1, BODY), np.zeros(1, STATE), np.zeros((1, 4))
    body[0] = draw_body(0, "r1", (0.5, 0.5, 0.2, 0.0), Tank(), Body())
    body["sensor_m"] = 0.13
    state["position_m"], state["quaternion"] = (0.5, 0.5, 0.2), quaternion(roll, pitch, 0.7)
    state["velocity_m_s"] = velocity
    water_pressure_pa(body, state, SURFACE_M, pressure_pa)
    return pressure_pa[0] / PA_PER_M


@pytest.mark.parametrize(("roll", "pitch"), [(0.0, 0.0), (0.2, 0.0), (0.0, -0.15), (0.1, 0.25), (-0.3, 0.2)])
def test_four_depths_give_depth_roll_and_pitch_back(roll, pitch):
    z1, z2, z3, z4 = depths_m(roll, pitch)
    assert (z1 + z2 + z3 + z4) / 4 == pytest.approx(0.3)
    assert -math.asin((z1 + z2 - z3 - z4) / (4 * 0.13 * math.cos(pitch))) == pytest.approx(roll)
    assert -math.asin((-z1 + z2 + z3 - z4) / (4 * 0.13)) == pytest.approx(pitch)
    assert z1 - z2 + z3 - z4 == pytest.approx(0, abs=1e-12)


def test_nose_down_puts_the_front_sensors_deeper():
    z1, z2, z3, z4 = depths_m(pitch=0.1)
    assert z1 == z4 > z2 == z3


def test_moving_ahead_presses_on_the_front_and_pulls_at_the_back():
    still, moving = depths_m(), depths_m(velocity=(0.3, 0.0, 0.0))
    head_m = 0.3**2 / (2 * 9.81) / math.sqrt(2)
    np.testing.assert_allclose(moving - still, head_m * np.array([1, -1, -1, 1]), rtol=1e-9)


def test_readings_are_noisy_quantised_and_one_sample_late():
    sensors = PressureSensors(3, ["r1", "r2"])
    deep_pa = np.full((2, 4), 4000.0)
    shallow = sensors.sample(deep_pa, 0.0)
    assert np.all(np.abs(shallow - ATMOSPHERE_PA) < 1000)  # still that of the surface
    readings = np.array([sensors.sample(deep_pa, 0.01 * k) for k in range(2000)])
    np.testing.assert_allclose(readings / STEP_PA, np.round(readings / STEP_PA), atol=1e-6)
    assert np.std(readings, axis=0) == pytest.approx(math.hypot(NOISE_M * PA_PER_M, STEP_PA / math.sqrt(12)), rel=0.1)


def test_the_tare_takes_offset_and_weather_out():
    sensors = PressureSensors(3, ["r1", "r2"])
    tare_pa = sensors.tare_pa()
    deep_pa = np.full((2, 4), 0.4 * PA_PER_M)
    readings = np.mean([sensors.sample(deep_pa, 0.0) for _ in range(400)][1:], axis=0)
    np.testing.assert_allclose((readings - tare_pa) / PA_PER_M, 0.4, atol=2e-4)
    assert np.ptp(tare_pa) > 5  # the offsets are there


def test_a_robots_readings_do_not_depend_on_who_dives_with_it():
    alone, together = PressureSensors(3, ["r2"]), PressureSensors(3, ["r1", "r2"])
    np.testing.assert_array_equal(alone.tare_pa()[0], together.tare_pa()[1])


def follow(nominal_deg, motor=0.0, shaft=0.0, seconds=2.0, gain=1.0, zero=0.0, low=-93.0, high=93.0):
    path = []
    for _ in range(round(seconds / STEP_S)):
        motor = motor_deg_after(motor, nominal_deg, gain, zero, low, high, STEP_S)
        shaft = shaft_deg_after(shaft, motor)
        path.append((motor, shaft))
    return np.array(path)


def test_a_servo_slews_no_faster_than_it_can_and_arrives():
    motor = follow(80.0)[:, 0]
    assert np.max(np.diff(motor)) == pytest.approx(SLEW_DEG_S * STEP_S)
    assert motor[-1] == pytest.approx(80.0, abs=1e-6)
    assert np.all(np.diff(motor) >= 0)


def test_play_leaves_the_shaft_on_the_side_it_came_from():
    up = follow(10.0)[-1]
    down = follow(10.0, *follow(20.0)[-1])[-1]
    assert up[1] == pytest.approx(10.0 - PLAY_DEG / 2, abs=1e-6)
    assert down[1] == pytest.approx(10.0 + PLAY_DEG / 2, abs=1e-6)
    nudged = follow(10.0 + 0.6 * PLAY_DEG, *down)[-1]  # within the play: nothing moves
    assert nudged[1] == pytest.approx(down[1], abs=1e-6)


def test_scale_and_zero_errors_and_stops():
    assert follow(50.0, gain=1.01, zero=-0.7)[-1, 0] == pytest.approx(49.8)
    assert follow(200.0)[-1, 0] == pytest.approx(93.0)


# --- waves ---
# A standing wave, as the sensors of a dive see it.


def test_a_wave_has_its_period_and_shows_less_at_depth():
    still, wavy = boardless_dive(), boardless_dive(scene=Scene(name="wavy", waves=Waves(amplitude_m=0.005)))
    off_pa = []
    for _ in range(400):
        for made in (still, wavy):
            made.move()
        off_pa.append(wavy._water_pa - still._water_pa)
    k = math.pi / 1.5
    omega = math.sqrt(9.81 * k * math.tanh(k * 0.5))  # 4.0 rad/s: the tank's first mode
    x_m, z_m = wavy.states["position_m"][:, 0], wavy.states["position_m"][:, 2]
    crest_pa = 0.005 * PA_PER_M * np.cosh(k * z_m) / np.cosh(k * 0.5) * np.cos(k * x_m)
    crest_pa *= math.cos(k * 0.13)  # what four sensors before and behind the middle see of it
    t_s = 0.01 * np.arange(1, 401)
    np.testing.assert_allclose(
        np.mean(off_pa, axis=2), np.outer(np.cos(omega * t_s), crest_pa), atol=0.005 * np.abs(crest_pa).max()
    )
