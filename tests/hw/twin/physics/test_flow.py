"""Water that flows and tethers that pull, against what Galileo, Archimedes and the drag's own root say."""

import math

import numpy as np
import pytest

from hw.twin import scene
from hw.twin.physics.body import FREE_SLACK, TETHER_DRAG, cast_off, euler_rad, quaternion, to_body
from hw.twin.physics.sensors import water_pressure_pa
from hw.twin.physics.tank import STEP_S, Flow, push
from hw.twin.scene import Current, Pull, Scene, StartSigma, put_off
from tests.hw.twin.physics.test_tank import SIZE_M, SURFACE_M, hull, run
from tests.hw.twin.stand_ins import boardless_dive
from tests.hw.twin.stand_ins import run as run_dive

CURRENT = (0.06, -0.04, 0.01)


def free(**changes):
    """As hull, with three different added masses, and nothing that holds it."""
    body, state = hull(mooring=0.0, added_kg=(2.0, 3.0, 4.0), **changes)
    state["stirred"] = 1
    return body, state


def test_to_who_drifts_along_a_current_is_still_water():
    """The same dive seen from a boat that drifts: Munk, Coriolis, drag and tether of the velocity through the water."""
    ends = []
    for current in ((0.0, 0.0, 0.0), CURRENT):
        body, state = free(tether_drag=TETHER_DRAG)
        state["quaternion"], state["rates_rad_s"] = quaternion(0.2, -0.1, 0.7), (0.3, -0.2, 0.9)
        q = tuple(state["quaternion"][0])
        state["velocity_m_s"] = np.array((0.15, 0.10, -0.05)) + to_body(q, current)
        state["water_m_s"] = current
        run(body, state, 4.0, dt_s=STEP_S / 8)
        drifted = state["position_m"][0] - 4.0 * np.array(current)
        ends.append((drifted, state["quaternion"][0].copy(), state["rates_rad_s"][0].copy()))
    for still, seen in zip(*ends, strict=True):
        np.testing.assert_allclose(seen, still, atol=5e-5)  # of 2 ms each, steps are 8 times as wrong
    assert np.linalg.norm(ends[0][0] - (2.0, 2.0, 2.0)) > 0.1


@pytest.mark.parametrize("heavier_kg", [0.0, 1.5])
def test_water_that_speeds_up_takes_along_what_it_displaces(heavier_kg):
    """Archimedes sideways: a hull that weighs what it displaces moves as the water in its place would."""
    body, state = free(linear_drag=0.0, quadratic_drag=0.0, buoyancy_arm_m=0.0)
    body["mass_kg"] += heavier_kg
    state["water_m_s2"] = (0.05, 0.0, 0.0)
    run(body, state, 0.1)  # before it has sunk far
    share = (body["displaced_kg"][0] + 2.0) / (body["mass_kg"][0] + 2.0)
    assert state["water_m_s"][0, 0] == pytest.approx(0.005)
    assert state["velocity_m_s"][0, 0] == pytest.approx(0.005 * share, rel=5e-3)


def test_a_free_hull_ends_up_as_fast_as_the_current_and_a_moored_one_leans_on_its_lines():
    body, state = free()
    state["water_m_s"] = (0.0, 0.1, 0.0)
    run(body, state, 12.0)
    assert state["velocity_m_s"][0, 1] == pytest.approx(0.1, rel=0.05)
    body, state = hull()
    state["stirred"], state["water_m_s"] = 1, (0.0, 0.1, 0.0)
    run(body, state, 5.0)
    assert state["position_m"][0, 1] - 2.0 == pytest.approx((2 * 0.1 + 20 * 0.01) / 300.0, rel=0.02)


def test_a_tether_takes_its_share_of_the_speed():
    body, state = free(tether_drag=TETHER_DRAG)
    push(state[0], (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 100.0)
    run(body, state, 5.0)
    # The tether drags at the top of the hull, which leans back; across a lean of a degree that changes nothing.
    root = (-2 + math.sqrt(4 + 4 * (20 + TETHER_DRAG) * 1.0)) / (2 * (20 + TETHER_DRAG))
    speed = np.linalg.norm(state["velocity_m_s"][0])
    assert speed == pytest.approx(root, rel=5e-3)
    assert 0.2 < math.degrees(abs(euler_rad(state["quaternion"][0])[1])) < 5.0


def test_walls_hold_who_swims_against_them():
    body, state = free()
    push(state[0], (2.0, 0.0, 0.0), (0.0, 0.0, 0.0), 100.0)
    run(body, state, 12.0)
    assert SIZE_M[0] - 0.14 - 5e-3 < state["position_m"][0, 0] < SIZE_M[0] - 0.13


def test_sensors_feel_the_water_that_comes_as_they_feel_their_own_way_through_it():
    pressures = []
    for own, water in (((0.2, 0.1, 0.0), (0.0, 0.0, 0.0)), ((0.0, 0.0, 0.0), (-0.2, -0.1, 0.0))):
        body, state = free(stagnation=1.0)
        state["velocity_m_s"], state["water_m_s"] = own, water
        pressure_pa = np.zeros((1, 4))
        water_pressure_pa(body, state, SURFACE_M, pressure_pa)
        pressures.append(pressure_pa)
    np.testing.assert_allclose(pressures[0], pressures[1])
    assert np.ptp(pressures[0]) > 10


# --- at random ----------------------------------------------------------------------------------------------------


def walked(flow, ticks):
    """Water velocity and pull (ticks, 3) each."""
    _, state = hull()
    rows = []
    for _ in range(ticks):
        flow.tick(state)
        rows.append((state["water_m_s"][0].copy(), state["pull_n"][0].copy()))
    return np.array(rows).transpose(1, 0, 2)


def test_gusts_and_pulls_are_as_strong_as_they_say_and_forget_themselves(monkeypatch):
    monkeypatch.setattr("hw.twin.physics.tank.TICK_S", 0.1)
    flow = Flow(1, ["r1"], Current(velocity_m_s=CURRENT, gust_m_s=0.01), Pull(force_n=0.05, correlation_s=0.5))
    water, pull = walked(flow, 3000)
    np.testing.assert_allclose(water.mean(0)[:2], CURRENT[:2], atol=5e-3)
    np.testing.assert_allclose(water.std(0)[:2], 0.01, rtol=0.3)  # 300 s are 75 of its memories
    assert np.all(water[:, 2] == CURRENT[2]) and np.all(pull[:, 2] == 0)
    assert np.sqrt(np.mean(np.sum(pull**2, 1))) == pytest.approx(0.05, rel=0.15)
    later = [np.mean(pull[:-k, 0] * pull[k:, 0]) / np.mean(pull[:, 0] ** 2) for k in (5, 10)]
    np.testing.assert_allclose(later, np.exp([-1, -2]), atol=0.1)


def test_still_water_and_slack_tethers_draw_nothing():
    flow = Flow(1, ["r1"], Current(), Pull(correlation_s=0.2))
    assert not flow.active
    flow.pull(0, Pull(force_n=0.1, correlation_s=0.2), for_s=1.0)
    _, pull = walked(flow, 300)
    assert flow.active and 0.03 < np.abs(pull[50:100]).mean() < 0.2
    assert np.abs(pull[-1]).max() < 1e-3  # it fades after its second


def test_the_water_follows_a_current_that_is_changed():
    flow = Flow(1, ["r1"], Current(), Pull())
    flow.set_current((0.1, 0.0, 0.0))
    water, _ = walked(flow, 101)
    assert water[0, 0] == 0 and water[100, 0] == pytest.approx(0.1 * (1 - math.exp(-1)), rel=0.01)


# --- in a dive ----------------------------------------------------------------------------------------------------


def test_who_is_not_moored_is_free_once_let_go_and_no_other_number_changes():
    moored, free_dive = boardless_dive(), boardless_dive(scene=Scene(name="swim", moored=False))
    assert np.all(free_dive.bodies["mooring"] == 0)
    assert np.all(free_dive.bodies["tether_m"] == pytest.approx(FREE_SLACK * math.sqrt(1.5**2 + 1.2**2 + 0.8**2)))
    for name in ("mass_kg", "linear_drag", "servo_zero_deg", "home_m"):
        np.testing.assert_array_equal(moored.bodies[name], free_dive.bodies[name])
    for dive in (moored, free_dive):
        dive.states["held"] = 0, 1
        dive.push("r1", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5)
        dive.push("r2", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.5)
        for _ in range(100):
            dive.move()
    off_m = [dive.states["position_m"][:, 0] - dive.bodies["home_m"][:, 0] for dive in (moored, free_dive)]
    assert off_m[0][0] < 0.004 and off_m[1][0] > 0.03
    assert off_m[0][1] == off_m[1][1] == 0  # in the hands of the crew


def test_casting_off_makes_the_body_that_a_swim_begins_with():
    moored, free_dive = boardless_dive(), boardless_dive(scene=Scene(name="swim", moored=False))
    cast_off(moored.bodies[0], moored._tank)
    assert moored.bodies[0] == free_dive.bodies[0]


def test_the_crew_puts_robots_about_where_the_file_says():
    sigma = StartSigma(place_m=0.05, yaw_deg=5.0)
    off = np.array([put_off(sigma, (0.4, 0.5, 90.0), seed, "r1") for seed in range(300)]) - (0.4, 0.5, 90.0)
    np.testing.assert_allclose(off.std(0), (0.044, 0.044, 4.4), rtol=0.15)  # cut off at two sigma
    assert abs(off).max(0) == pytest.approx((0.1, 0.1, 10.0))
    made = boardless_dive(scene=Scene(name="swim", start_sigma=sigma))
    assert made.states["position_m"][0, 0] == pytest.approx(put_off(sigma, (0.4, 0.5, 0.0), 4, "r1")[0], abs=5e-3)


def test_a_current_a_pull_and_a_casting_off_come_when_the_scene_says():
    events = (
        scene.CurrentSet(at_s=0.2, velocity_m_s=(0.1, 0.0, 0.0)),
        scene.TetherPull(at_s=0.3, robot="r2", force_n=0.2, correlation_s=0.1, for_s=1.0),
        scene.CastOff(at_s=0.4, robot="r1"),
    )
    made = boardless_dive(scene=Scene(name="swim", event=events))
    run_dive(made, 20)
    assert not made.states["water_m_s"].any() and not made._flow.active
    run_dive(made, 15)
    assert np.all(made.states["water_m_s"][:, 0] > 0.01)
    assert made.states["pull_n"][1].any() and not made.states["pull_n"][0].any()
    assert made.bodies["mooring"][0].any()
    run_dive(made, 10)
    assert not made.bodies["mooring"][0].any() and made.bodies["mooring"][1].any()
