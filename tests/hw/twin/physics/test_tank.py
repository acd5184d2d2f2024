"""The physics against closed forms: a hull alone, with the hidden spreads taken out where a figure is needed."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import Body, Navigation, Tank
from hw.firmware.bus import NO_GRAVITY
from hw.firmware.wire import NO_RATE
from hw.twin.dive import Dive
from hw.twin.physics.body import (
    BODY,
    HULL_M,
    MOORING,
    draw_body,
    draw_servos,
    euler_rad,
    matrix,
    quaternion,
    static_thrust_n,
    to_body,
    to_world,
)
from hw.twin.physics.forces import GRAVITY_M_S2, TETHER_WEIGHT_N, add_water
from hw.twin.physics.tank import (
    FULL_SCALE_CDEG_S,
    NOISE_DEG_S,
    STATE,
    STEP_S,
    WALK_DEG_S,
    ZERO_DEG_S,
    Gyros,
    advance,
    push,
)
from tests.hw.twin.stand_ins import RecordingBoard, fleet

SIZE_M = np.array([4.0, 4.0, 4.0])
SURFACE_M = 3.5
STILL_US = np.full((1, 8), 1500.0)
LEVEL = np.zeros((1, 4))


def hull(**changes):
    """One robot in the middle of a large tank, without spreads: neutral, thrusters exact and quick."""
    body = np.zeros(1, BODY)
    body[0] = draw_body(0, "r1", (2.0, 2.0, 2.0, 0.0), Tank(), Body())
    body["mass_kg"], body["added_kg"] = 4.0, (2.0, 2.0, 4.0)
    body["displaced_kg"] = 4.0 + TETHER_WEIGHT_N / GRAVITY_M_S2
    body["inertia_kgm2"], body["added_inertia_kgm2"] = (0.045, 0.045, 0.06), 0.03
    body["linear_drag"], body["quadratic_drag"] = (2, 2, 3, 0.03, 0.03, 0.03), (20, 20, 40, 0.12, 0.12, 0.10)
    body["buoyancy_arm_m"], body["arm_m"], body["reaction_m"] = 0.01, (0.08, 0.06), 0.012
    body["neutral_us"], body["thrust_gain"], body["thrust_lag_s"] = 0.0, 1.0, 0.10
    body["home_m"], body["home_yaw_rad"], body["tether_m"] = (2.0, 2.0, 2.0), 0.0, 100.0
    for name, value in changes.items():
        body[name] = value
    state = np.zeros(1, STATE)
    state["position_m"], state["quaternion"] = body["home_m"], (1, 0, 0, 0)
    return body, state


def run(body, state, seconds, pulses_us=STILL_US, dt_s=STEP_S):
    advance(body, state, pulses_us, LEVEL, SIZE_M, SURFACE_M, dt_s, round(seconds / dt_s))


def test_quaternions_turn_as_the_matrix_of_the_euler_angles_does():
    roll, pitch, yaw = 0.3, -0.7, 2.1
    cr, sr, cp, sp, cy, sy = (*(f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin)),)
    Rx = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    Ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    Rz = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    q = quaternion(roll, pitch, yaw)
    v = (0.2, -1.0, 0.5)
    np.testing.assert_allclose(matrix(q), Rz @ Ry @ Rx, atol=1e-14)
    np.testing.assert_allclose(to_world(tuple(q), v), Rz @ Ry @ Rx @ v, atol=1e-14)
    np.testing.assert_allclose(to_body(tuple(q), to_world(tuple(q), v)), v, atol=1e-14)
    np.testing.assert_allclose(euler_rad(q), (roll, pitch, yaw), atol=1e-12)


def test_first_acceleration_is_force_over_mass_with_the_water_that_moves_along():
    body, state = hull()
    push(state[0], (0.0, 0.0, 10.0), (0.0, 0.0, 0.0), 1.0)
    run(body, state, STEP_S)
    assert state["velocity_m_s"][0, 2] / STEP_S == pytest.approx(10.0 / (4.0 + 4.0), rel=1e-6)


def test_a_push_at_a_corner_turns_and_ends_after_its_time():
    body, state = hull()
    push(state[0], (0.0, 0.0, -8.0), (0.13, 0.13, 0.0), 0.1)
    run(body, state, STEP_S)
    roll_rate, pitch_rate, _ = state["rates_rad_s"][0]
    assert roll_rate / STEP_S == pytest.approx(-8 * 0.13 / 0.075, rel=1e-6)  # the left side goes down
    assert pitch_rate / STEP_S == pytest.approx(8 * 0.13 / 0.075, rel=1e-6)  # and so does the nose
    run(body, state, 0.1)
    assert state["push_s"][0] <= 0
    speed = state["velocity_m_s"][0, 2]
    run(body, state, 0.1)
    assert abs(state["velocity_m_s"][0, 2]) < abs(speed)


@pytest.mark.parametrize("force_n", [3.0, -3.0])
def test_terminal_velocity_is_the_root_of_the_drag(force_n):
    body, state = hull(home_m=(2.0, 2.0, 1.75))
    push(state[0], (0.0, 0.0, force_n), (0.0, 0.0, 0.0), 100.0)
    run(body, state, 5.0)
    root = (-3 + math.sqrt(3**2 + 4 * 40 * abs(force_n))) / (2 * 40)
    assert state["velocity_m_s"][0, 2] == pytest.approx(math.copysign(root, force_n), rel=1e-3)


def test_drag_takes_energy_out_of_every_motion():
    rng = np.random.default_rng(1)
    body, _ = hull()
    for _ in range(500):
        v, w, wrench = tuple(rng.normal(0, 1, 3)), tuple(rng.normal(0, 2, 3)), np.zeros(6)
        add_water(body[0], v, w, wrench)
        assert np.sum(wrench * (*v, *w)) < 0


def test_turning_and_munk_terms_do_no_work():
    rng = np.random.default_rng(1)
    body, _ = hull(linear_drag=0.0, quadratic_drag=0.0)
    for _ in range(500):
        v, w, wrench = tuple(rng.normal(0, 1, 3)), tuple(rng.normal(0, 2, 3)), np.zeros(6)
        add_water(body[0], v, w, wrench)
        assert np.any(wrench != 0)
        assert np.sum(wrench * (*v, *w)) == pytest.approx(0, abs=1e-12)


def test_energy_is_kept_without_drag():
    body, state = hull(linear_drag=0.0, quadratic_drag=0.0, buoyancy_arm_m=0.0, mooring=0.0)
    state["velocity_m_s"], state["rates_rad_s"] = (0.02, -0.01, 0.03), (0.5, -0.4, 0.2)

    def energy():
        v, w = state["velocity_m_s"][0], state["rates_rad_s"][0]
        moving = np.sum((4.0 + body["added_kg"][0]) * v**2)
        turning = np.sum((body["inertia_kgm2"] + body["added_inertia_kgm2"])[0] * w**2)
        return 0.5 * (moving + turning)

    start = energy()
    run(body, state, 10.0, dt_s=1e-4)
    assert energy() == pytest.approx(start, rel=1e-4)


def test_a_hull_swings_about_level_with_the_period_of_its_righting_moment():
    body, state = hull(linear_drag=0.0, quadratic_drag=0.0)
    state["quaternion"] = quaternion(0.02, 0.0, 0.0)
    rolls = []
    for _ in range(5000):
        run(body, state, STEP_S)
        rolls.append(euler_rad(state["quaternion"][0])[0])
    crossings = np.flatnonzero(np.diff(np.sign(rolls)) > 0)
    period_s = np.mean(np.diff(crossings)) * STEP_S
    lift_n = body["displaced_kg"][0] * GRAVITY_M_S2
    assert period_s == pytest.approx(2 * math.pi * math.sqrt(0.075 / (lift_n * 0.01)), rel=5e-3)


def test_a_light_hull_comes_to_rest_where_it_displaces_its_weight():
    body, state = hull(displaced_kg=4.4, linear_drag=(2, 2, 30, 0.03, 0.03, 0.03))
    run(body, state, 30.0)
    wet = (SURFACE_M - state["position_m"][0, 2] + HULL_M[2]) / (2 * HULL_M[2])
    assert wet == pytest.approx((4.0 + TETHER_WEIGHT_N / GRAVITY_M_S2) / 4.4, abs=2e-3)


def test_a_heavy_hull_lies_on_the_floor_and_two_hulls_do_not_sink_into_one_another():
    body, state = hull(displaced_kg=3.9)
    run(body, state, 30.0)
    assert state["position_m"][0, 2] == pytest.approx(HULL_M[2], abs=2e-3)

    bodies, states = (np.repeat(a, 2) for a in hull())
    states["position_m"][1, 0] += 0.2
    bodies["home_m"] = states["position_m"]
    advance(bodies, states, np.repeat(STILL_US, 2, 0), np.zeros((2, 4)), SIZE_M, SURFACE_M, STEP_S, 5000)
    apart_m = states["position_m"][1, 0] - states["position_m"][0, 0]
    spring_m = (2 * HULL_M[0] - 0.2) * MOORING[0] / (MOORING[0] + 2 * 2000.0)  # two moorings against one contact
    assert apart_m == pytest.approx(2 * HULL_M[0] - spring_m, abs=1e-3)


def test_central_thrusters_lift_and_turn_with_the_signs_of_the_paper():
    for k, (roll, pitch, yaw) in enumerate([(1, -1, 1), (1, 1, -1), (-1, 1, 1), (-1, -1, -1)]):
        body, state = hull()
        pulses_us = STILL_US.copy()
        pulses_us[0, k] = 1700.0
        run(body, state, 0.02, pulses_us)
        assert state["velocity_m_s"][0, 2] > 0
        np.testing.assert_array_equal(np.sign(state["rates_rad_s"][0]), (roll, pitch, yaw))


def test_peripheral_thrusters_all_turn_left_and_in_pairs_push():
    body, state = hull()
    pulses_us = STILL_US.copy()
    pulses_us[0, 4:] = 1700.0
    run(body, state, 0.02, pulses_us)
    assert state["rates_rad_s"][0, 2] > 0
    np.testing.assert_allclose(state["velocity_m_s"][0], 0, atol=1e-9)
    body, state = hull()
    pulses_us[0, 4:] = 1300.0, 1300.0, 1700.0, 1700.0
    run(body, state, 0.02, pulses_us)
    assert state["velocity_m_s"][0, 0] > 0
    assert abs(state["velocity_m_s"][0, 1]) < 1e-4 * state["velocity_m_s"][0, 0]  # a trace of tilt


def test_a_thruster_has_a_dead_band_an_own_zero_and_less_force_astern():
    assert static_thrust_n(1900.0, 0.0, 1.0) == pytest.approx(10.0)
    assert static_thrust_n(1100.0, 0.0, 1.0) == pytest.approx(-10.0 * 28.6 / 36.4)
    assert static_thrust_n(2500.0, 0.0, 1.0) == static_thrust_n(1900.0, 0.0, 1.0)
    assert {static_thrust_n(float(us), 0.0, 1.0) for us in range(1464, 1537)} == {0.0}
    assert static_thrust_n(1545.0, 0.0, 1.0) > 0
    assert static_thrust_n(1545.0, 10.0, 1.0) == 0.0
    assert static_thrust_n(1700.0, 0.0, 1.05) == pytest.approx(1.05 * static_thrust_n(1700.0, 0.0, 1.0))
    assert static_thrust_n(0.0, 0.0, 1.0) == 0.0  # no pulses


def test_thrust_follows_with_its_lag_and_fades_without_pulses():
    body, state = hull()
    full_us = np.full((1, 8), 1900.0)
    run(body, state, 0.1, full_us)
    np.testing.assert_allclose(state["thrust_n"][0], 10 * (1 - math.exp(-1)), rtol=1e-9)
    run(body, state, 0.1, np.zeros((1, 8)))
    np.testing.assert_allclose(state["thrust_n"][0], 10 * (1 - math.exp(-1)) * math.exp(-1), rtol=1e-9)


def test_the_mooring_holds_place_and_heading():
    body, state = hull()
    push(state[0], (0.3, 0.0, 0.0), (0.0, 0.01, 0.0), 100.0)  # 0.3 N, 3 mN m
    run(body, state, 5.0)
    assert state["position_m"][0, 0] - 2.0 == pytest.approx(0.3 / MOORING[0], rel=0.02)
    assert 0 < abs(math.degrees(euler_rad(state["quaternion"][0])[2])) < 0.1


def test_a_held_robot_does_not_move_but_its_servos_do():
    body, state = hull(displaced_kg=5.0)
    state["held"] = 1
    before = state["position_m"].copy()
    advance(body, state, np.full((1, 8), 1900.0), np.full((1, 4), 20.0), SIZE_M, SURFACE_M, STEP_S, 500)
    np.testing.assert_array_equal(state["position_m"], before)
    assert np.all(state["shaft_deg"] > 15)


def test_the_bench_has_the_servos_of_the_dive():
    alone = np.zeros((), BODY)
    draw_servos(alone, 7, "r2", Body())
    whole = draw_body(7, "r2", (0.3, 0.25, 0.1, 34.0), Tank(), Body())
    for name in ("servo_gain", "servo_zero_deg", "servo_low_deg", "servo_high_deg"):
        np.testing.assert_array_equal(alone[name], whole[name])
    assert np.ptp(alone["servo_gain"]) > 0


def test_robots_differ_between_seeds_and_the_same_seed_gives_the_same_robot():
    start = (0.3, 0.25, 0.1, 34.0)
    one, again, other = (draw_body(seed, "r1", start, Tank(), Body()) for seed in (1, 1, 2))
    assert one == again
    assert one["mass_kg"] != other["mass_kg"]
    assert abs(one["displaced_kg"] / one["mass_kg"] - 1) <= 0.01
    np.testing.assert_allclose(one["home_m"], start[:3], atol=5e-3)


# --- gyro ---
# The twin's gyros: what they say of a turn, how much of it is noise, and which robots have one.

ROBOTS = [f"r{i}" for i in range(400)]


def readings(gyros, rates, n):
    return np.array([gyros.read(np.asarray(rates, float)) for _ in range(n)]) / 100.0


def test_a_turn_is_told_with_the_errors_of_the_data_sheet() -> None:
    rates = np.zeros((len(ROBOTS), 3))
    still = readings(Gyros(3, ROBOTS, True), rates, 100)[20:]
    assert still.mean(axis=0).std() == pytest.approx(ZERO_DEG_S, rel=0.15)
    assert np.diff(still, axis=0).std() == pytest.approx(NOISE_DEG_S * math.sqrt(2), rel=0.05)
    rates[:, 2] = math.radians(90.0)
    turning = readings(Gyros(3, ROBOTS, True), rates, 100)[20:]
    errors = turning.mean(axis=0) - still.mean(axis=0) - 90.0
    assert errors.std() == pytest.approx(0.45, rel=0.15)  # 0.5 % of it


def test_its_zero_wanders_as_a_random_walk() -> None:
    told = readings(Gyros(3, ROBOTS, True), np.zeros((len(ROBOTS), 3)), 1000)
    moved = told[-100:].mean(axis=0) - told[:100].mean(axis=0)
    assert moved.std() == pytest.approx(math.hypot(WALK_DEG_S * math.sqrt(9.0), NOISE_DEG_S * math.sqrt(0.02)), rel=0.2)


def test_it_says_no_more_than_it_can_and_breaks_as_it_is_told() -> None:
    gyros = Gyros(3, ["r1", "r2"], True)
    assert readings(gyros, [[0, 0, 20.0], [0, 0, -20.0]], 30)[-1] == pytest.approx([250.13, -250.13])
    assert FULL_SCALE_CDEG_S == 25_013
    gyros.fail("r1", stuck=True)
    gyros.fail("r2", stuck=False)
    assert readings(gyros, np.zeros((2, 3)), 5)[-1] == pytest.approx([250.13, NO_RATE / 100])


@pytest.mark.parametrize("fitted", [False, True])
def test_the_boards_of_a_fleet_with_gyros_have_one_and_nothing_else_changes(fitted) -> None:
    asked = replace(fleet(), navigation=Navigation(gyro=fitted))
    one, other = (Dive(each, ["r1", "r2"], 0) for each in (asked, fleet()))
    for dive in (one, other):
        dive.boards = [RecordingBoard(), RecordingBoard()]
        dive.states["held"] = 0
        for _ in range(20):
            dive.tick(0.0)
    rates = [tick[6] for tick in one.boards[0].ticks]
    assert (len(set(rates)) > 5) if fitted else set(rates) == {NO_RATE}
    assert [tick[:6] for tick in one.boards[0].ticks] == [tick[:6] for tick in other.boards[0].ticks]


@pytest.mark.parametrize(("roll_deg", "up_mg", "level_mg"), [(0, 1000, 0), (30, 866, 500), (180, -1000, 0)])
def test_an_accelerometer_says_where_up_is(roll_deg, up_mg, level_mg) -> None:
    states = np.zeros(2, STATE)
    states["quaternion"] = quaternion(math.radians(roll_deg), 0.0, 0.4)
    says = np.mean([Gyros(3, ["r1", "r2"], True).gravity_mg(states) for _ in range(50)], axis=0)
    np.testing.assert_allclose(says, [[up_mg, level_mg]] * 2, atol=80.0)
    assert Gyros(3, ["r1", "r2"], False).gravity_mg(states) == [NO_GRAVITY] * 2
    dead = Gyros(3, ["r1", "r2"], True)
    dead.fail("r2", stuck=False)
    assert dead.gravity_mg(states)[1] == NO_GRAVITY != dead.gravity_mg(states)[0]
