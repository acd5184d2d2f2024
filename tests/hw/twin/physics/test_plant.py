"""Overrides of what is drawn for a robot: only what they name, only whom they name."""

import numpy as np

from hw.twin.physics.body import F_MAX_N
from hw.twin.physics.sensors import NOISE_M
from hw.twin.physics.tank import Plant
from tests.hw.twin.stand_ins import boardless_dive, readings_m, run


def test_the_default_plant_changes_nothing():
    plain, planned = boardless_dive(), boardless_dive(plants={"r1": Plant()})
    assert plain.bodies.tobytes() == planned.bodies.tobytes()
    run(plain, 50), run(planned, 50)
    assert plain._readings_pa == planned._readings_pa


def test_a_plant_is_one_robots_alone():
    plain, planned = boardless_dive(), boardless_dive(plants={"r2": Plant(mass_scale=1.4, lag_s=0.15, f_max_n=5.0)})
    was, is_now = plain.bodies[1], planned.bodies[1]
    for name in ("mass_kg", "displaced_kg", "added_kg", "inertia_kgm2", "added_inertia_kgm2"):
        np.testing.assert_allclose(is_now[name], 1.4 * was[name])
    np.testing.assert_array_equal(is_now["thrust_lag_s"], 0.15)
    np.testing.assert_allclose(is_now["thrust_gain"], was["thrust_gain"] * 5.0 / F_MAX_N)
    assert plain.bodies[0] == planned.bodies[0]


def test_noise_delay_and_dynamic_pressure_of_a_plant():
    made = boardless_dive(plants={"r1": Plant(noise_m=0.0, late_samples=3), "r2": Plant(dynamic_pressure=0.0)})
    made.states["position_m"][0, 2] -= 0.1
    moved = [readings_m(made)[0] < 0.45]
    for _ in range(4):
        made.move()
        moved.append(readings_m(made)[0] < 0.45)
    assert moved == [True, True, True, True, False]  # read first by the next sample, three before it arrives
    made.states["held"], made.states["velocity_m_s"] = 1, (0.5, 0.0, 0.0)
    for _ in range(5):
        made.move()
    assert np.ptp(readings_m(made, 0)) > 0.01
    assert np.ptp(readings_m(made, 1)) < 8 * NOISE_M
    made.states["velocity_m_s"] = 0.0
    quiet = []
    for _ in range(50):
        made.move()
        quiet.append(readings_m(made, 0))
    assert np.std(quiet[10:], axis=0).max() < 0.1 * NOISE_M
