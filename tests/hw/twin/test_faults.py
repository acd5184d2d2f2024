"""What goes wrong on demand: scene files that ask for it, faults of sensors, battery, thrusters, waves and plants."""

import math

import numpy as np
import pytest

from agent.config import ConfigError, Fleet, Pose, Robot, Target, Twin
from hw.twin.battery import NOMINAL_V, OHM
from hw.twin.devices import ALL_SENSORS, BATTERY_MV, CURRENT_10MA
from hw.twin.dive import Dive
from hw.twin.event import KINDS, Push, SensorDead
from hw.twin.plant import Plant
from hw.twin.scene import Waves, load_scene
from hw.twin.sensors import NOISE_M, PA_PER_M
from hw.twin.thruster import F_MAX_N


def fleet(names=("r1", "r2")):
    robots = {
        name: Robot(
            listen=f"tcp/127.0.0.1:{17401 + i}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=0.4 + 0.6 * i, y_m=0.5, yaw_deg=0.0),
            calibration="none.toml",
        )
        for i, name in enumerate(names)
    }
    return Fleet(fleet="tank", target={"ball": Target(radius_m=0.07)}, robot=robots, twin=Twin(seed=4))


class Recorder:
    """In the place of a board: takes what the hardware says, drives the pins that it is given."""

    def __init__(self):
        self.ticks = []
        self.driving = False

    def act(self, patience_s):
        return None

    def tick(self, *readings):
        self.ticks.append(readings)


def dive(**keywords):
    made = Dive(fleet(), ["r1", "r2"], 0, **keywords)
    made.boards = [Recorder(), Recorder()]
    return made


def readings_m(made, robot=0):
    return (np.array(made._readings_pa[robot]) - made.tare_pa[robot]) / PA_PER_M


def run(made, ticks):
    for _ in range(ticks):
        made.tick(0.0)


# --- scene files --------------------------------------------------------------------------------------------------


def scene_with(tmp_path, text):
    path = tmp_path / "scene.toml"
    path.write_text('name = "trouble"\n' + text)
    return load_scene(str(path))


def test_each_kind_of_event_has_a_table_that_is_read(tmp_path):
    more = {
        "push": "force_n = [0, 0, -8]\npoint_m = [0.13, 0.13, 0]\nfor_s = 0.3",
        "sensor_dead": "sensor = 1",
        "sensor_stuck": "sensor = 2",
        "sensor_offset": "sensor = 3\noffset_m = 0.05",
        "sensor_well": "sensor = 4",
        "battery": "volts = 11.5",
        "thruster_dead": "thruster = 8",
        "thruster_gain": "thruster = 1\ngain = 0.5",
        "serial_unplug": "for_s = 5.0",
        "power_cut": "for_s = 2.0",
    }
    tables = [f'[[event]]\nat_s = {i}\nkind = "{k}"\nrobot = "r1"\n{more.get(k, "")}\n' for i, k in enumerate(KINDS)]
    scene = scene_with(tmp_path, "".join(tables))
    assert len(scene.event) == len(KINDS) == 12
    assert scene.event[0] == Push(at_s=0, robot="r1", force_n=(0, 0, -8), point_m=(0.13, 0.13, 0), for_s=0.3)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ('kind = "psh"', r"event\[0\]\.kind': 'psh' is none of push, sensor_dead, "),
        ("", r"event\[0\]\.kind': None is none of push, "),
        ('kind = "leak"\nfor_s = 3.0', "unknown key `for_s`"),
        ('kind = "serial_unplug"', "required key `for_s` is missing"),
        ('kind = "sensor_dead"\nsensor = 5', "<= 4"),
        ('kind = "power_cut"\nfor_s = 0', "> 0"),
    ],
)
def test_an_event_that_cannot_be_is_one_line(tmp_path, table, says):
    with pytest.raises(ConfigError, match=says) as error:
        scene_with(tmp_path, f'[[event]]\nat_s = 1.0\nrobot = "r1"\n{table}\n')
    assert "\n" not in str(error.value)


def test_an_event_for_a_robot_that_stays_ashore_is_refused():
    with pytest.raises(ConfigError, match="no robot 'r9' dives"):
        dive(events=[SensorDead(at_s=1.0, robot="r9", sensor=1)])


def test_events_strike_in_the_order_of_their_times():
    made = dive(
        events=[SensorDead(at_s=0.20, robot="r1", sensor=2), SensorDead(at_s=0.10, robot="r1", sensor=1)],
    )
    run(made, 30)
    masks = [tick[2] for tick in made.boards[0].ticks]
    assert masks == [0b1111] * 10 + [0b1110] * 10 + [0b1100] * 10
    assert {tick[2] for tick in made.boards[1].ticks} == {ALL_SENSORS}


# --- between the water and the firmware ---------------------------------------------------------------------------


def test_sensors_die_stick_lie_and_get_well():
    made = dive()
    run(made, 10)
    before = readings_m(made)
    made.kill_sensor("r1", 1)
    made.stick_sensor("r1", 2)
    made.shift_sensor("r1", 3, 0.05)
    run(made, 10)
    stuck = made._readings_pa[0][1]
    run(made, 10)
    after = readings_m(made)
    assert made._readings_pa[0][0] == 0.0 and made.faults.answered[0] == 0b1110
    assert made._readings_pa[0][1] == stuck and after[1] == pytest.approx(before[1])
    assert after[2] - before[2] == pytest.approx(0.05, abs=8 * NOISE_M)
    np.testing.assert_allclose(readings_m(made, 1), 0.4, atol=8 * NOISE_M)  # the other robot is well
    for sensor in (1, 2, 3):
        made.mend_sensor("r1", sensor)
    run(made, 2)
    np.testing.assert_allclose(readings_m(made), 0.4, atol=8 * NOISE_M)
    assert made.faults.answered[0] == ALL_SENSORS
    with pytest.raises(ValueError, match="they are 1 to 4"):
        made.kill_sensor("r1", 0)


def test_a_leak_is_told_to_one_board():
    made = dive()
    run(made, 1)
    made.leak("r2")
    run(made, 1)
    assert [[tick[5] for tick in board.ticks] for board in made.boards] == [[False, False], [False, True]]


def test_the_battery_sags_under_thrust_and_thrust_with_the_battery():
    made = dive()
    run(made, 1)
    assert made.boards[0].ticks[-1][3:5] == (BATTERY_MV, CURRENT_10MA)
    made._pulses_us[0], made.boards[0].driving = 1900.0, True
    run(made, 200)
    amperes, volts = made._drawn_a[0], made._supply_v[0]
    assert volts == pytest.approx(NOMINAL_V - OHM * (amperes - CURRENT_10MA / 100))
    assert 12.0 < volts < 13.0
    full_n = made.states["thrust_n"][0].sum()
    assert made.boards[0].ticks[-1][3] == pytest.approx(1000 * volts, abs=1)
    made.set_battery("r1", 12.0)
    run(made, 200)
    assert made.states["thrust_n"][0].sum() < 0.85 * full_n


def test_a_thruster_dies_and_another_runs_backwards():
    made = dive()
    made.scale_thruster("r1", 3, 0.0)
    made.scale_thruster("r1", 8, -1.0)
    made._pulses_us[:] = 1700.0
    for _ in range(100):
        made.move()
    thrust_n = made.states["thrust_n"]
    assert thrust_n[0, 2] == 0 and thrust_n[0, 7] < -1 and thrust_n[0, 0] > 1
    assert np.all(thrust_n[1] > 1)


# --- waves --------------------------------------------------------------------------------------------------------


def test_a_wave_has_its_period_and_shows_less_at_depth():
    still, wavy = dive(), dive(waves=Waves(amplitude_m=0.005))
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


# --- plants -------------------------------------------------------------------------------------------------------


def test_the_default_plant_changes_nothing():
    plain, planned = dive(), dive(plants={"r1": Plant()})
    assert plain.bodies.tobytes() == planned.bodies.tobytes()
    run(plain, 50), run(planned, 50)
    assert plain._readings_pa == planned._readings_pa


def test_a_plant_is_one_robots_alone():
    plain, planned = dive(), dive(plants={"r2": Plant(mass_scale=1.4, lag_s=0.15, f_max_n=5.0)})
    was, is_now = plain.bodies[1], planned.bodies[1]
    for name in ("mass_kg", "displaced_kg", "added_kg", "inertia_kgm2", "added_inertia_kgm2"):
        np.testing.assert_allclose(is_now[name], 1.4 * was[name])
    np.testing.assert_array_equal(is_now["thrust_lag_s"], 0.15)
    np.testing.assert_allclose(is_now["thrust_gain"], was["thrust_gain"] * 5.0 / F_MAX_N)
    assert plain.bodies[0] == planned.bodies[0]


def test_noise_delay_and_dynamic_pressure_of_a_plant():
    made = dive(plants={"r1": Plant(noise_m=0.0, late_samples=3), "r2": Plant(dynamic_pressure=0.0)})
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
