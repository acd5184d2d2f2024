"""Faults on demand: scene files that ask for them, and what sensors, leak probe, battery and thrusters then do."""

from unittest.mock import Mock, call

import msgspec
import numpy as np
import pytest

from agent.core.config import ConfigError
from hw.twin.board import ALL_SENSORS, BATTERY_MV, CURRENT_10MA
from hw.twin.dive import Dive, apply
from hw.twin.physics.body import NOMINAL_V, OHM
from hw.twin.physics.sensors import NOISE_M
from hw.twin.scene import (
    KINDS,
    Battery,
    CastOff,
    CurrentSet,
    FirmwareHang,
    GyroDead,
    GyroStuck,
    Leak,
    Occlude,
    PowerCut,
    Push,
    Scene,
    SensorDead,
    SensorOffset,
    SensorStuck,
    SensorWell,
    SerialUnplug,
    SlowBoard,
    Startle,
    TagLost,
    TetherPull,
    ThrusterDead,
    ThrusterGain,
    load_scene,
)
from tests.hw.twin.stand_ins import boardless_dive, readings_m, run


def scene_of(*events):
    return Scene(name="trouble", event=events)


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
        "slow_board": "by = 2.5",
        "tether_pull": "force_n = 0.15\ncorrelation_s = 4.0\nfor_s = 20.0",
        "current": "velocity_m_s = [0.0, 0.05, 0.0]",
        "occlude": "solid = 1\nto_m = [0.8, 0.7, 0.1]\nover_s = 4.0",
        "tag_lost": "id = 12",
        "startle": 'creature = "fish"\nspeed_m_s = 0.4\nfor_s = 1.0',
    }
    everybodys = ("current", "occlude", "tag_lost", "startle")
    kinds = KINDS
    whose = {kind: "" if kind in everybodys else 'robot = "r1"\n' for kind in kinds}
    tables = [f'[[event]]\nat_s = {i}\nkind = "{k}"\n{whose[k]}{more.get(k, "")}\n' for i, k in enumerate(kinds)]
    scene = scene_with(tmp_path, "".join(tables))
    assert len(scene.event) == len(kinds) == 21
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
        ('kind = "tag_lost"\nid = 12', "unknown key `robot`"),
    ],
)
def test_an_event_that_cannot_be_is_one_line(tmp_path, table, says):
    with pytest.raises(ConfigError, match=says) as error:
        scene_with(tmp_path, f'[[event]]\nat_s = 1.0\nrobot = "r1"\n{table}\n')
    assert "\n" not in str(error.value)


def test_an_event_for_a_robot_that_stays_ashore_is_refused():
    with pytest.raises(ConfigError, match="no robot 'r9' dives"):
        boardless_dive(scene=scene_of(SensorDead(at_s=1.0, robot="r9", sensor=1)))


@pytest.mark.parametrize(
    ("event", "says"),
    [
        (TagLost(at_s=1.0, id=12), "the fleet file has no tag 12; take the event out"),
        (Occlude(at_s=1.0, solid=0, to_m=(0, 0, 0), over_s=1.0), "solid 0 .* no stone .*; name one of 1, 2"),
        (Occlude(at_s=1.0, solid=7, to_m=(0, 0, 0), over_s=1.0), "solid 7 .* no stone"),
    ],
)
def test_an_event_that_nothing_can_meet_is_refused(event, says):
    scene = msgspec.structs.replace(load_scene("tank"), event=(event,))
    with pytest.raises(ConfigError, match=says):
        boardless_dive(scene=scene)


def test_events_strike_in_the_order_of_their_times():
    made = boardless_dive(
        scene=scene_of(SensorDead(at_s=0.20, robot="r1", sensor=2), SensorDead(at_s=0.10, robot="r1", sensor=1))
    )
    run(made, 30)
    masks = [tick[2] for tick in made.boards[0].ticks]
    assert masks == [0b1111] * 10 + [0b1110] * 10 + [0b1100] * 10
    assert {tick[2] for tick in made.boards[1].ticks} == {ALL_SENSORS}


DONE = {
    Push(at_s=0, robot="r1", force_n=(0, 0, -8), for_s=0.3): call.push("r1", (0, 0, -8), (0.0, 0.0, 0.0), 0.3),
    SensorDead(at_s=0, robot="r1", sensor=1): call.kill_sensor("r1", 1),
    GyroDead(at_s=0, robot="r1"): call.gyros.fail("r1", stuck=False),
    GyroStuck(at_s=0, robot="r1"): call.gyros.fail("r1", stuck=True),
    SensorStuck(at_s=0, robot="r1", sensor=2): call.stick_sensor("r1", 2),
    SensorOffset(at_s=0, robot="r1", sensor=3, offset_m=0.05): call.shift_sensor("r1", 3, 0.05),
    SensorWell(at_s=0, robot="r1", sensor=4): call.mend_sensor("r1", 4),
    Leak(at_s=0, robot="r1"): call.leak("r1"),
    Battery(at_s=0, robot="r1", volts=11.5): call.set_battery("r1", 11.5),
    ThrusterDead(at_s=0, robot="r1", thruster=8): call.scale_thruster("r1", 8, 0.0),
    ThrusterGain(at_s=0, robot="r1", thruster=1, gain=0.5): call.scale_thruster("r1", 1, 0.5),
    SerialUnplug(at_s=0, robot="r1", for_s=5.0): call.unplug("r1", 5.0),
    PowerCut(at_s=0, robot="r1", for_s=2.0): call.cut_power("r1", 2.0),
    FirmwareHang(at_s=0, robot="r1"): call.hang_firmware("r1"),
    SlowBoard(at_s=0, robot="r1", by=2.5): call.slow_board("r1", 2.5),
    TetherPull(at_s=0, robot="r1", force_n=0.1, for_s=2.0): call.pull_tether("r1", 0.1, 4.0, 2.0),
    CastOff(at_s=0, robot="r1"): call.cast_off("r1"),
    CurrentSet(at_s=0, velocity_m_s=(0.1, 0.0, 0.0)): call.set_current((0.1, 0.0, 0.0)),
    Occlude(at_s=0, solid=1, to_m=(0.8, 0.7, 0.1), over_s=4.0): call.move_solid(1, (0.8, 0.7, 0.1), 4.0),
    TagLost(at_s=0, id=12): call.lose_tag(12),
    Startle(at_s=0, creature="fish", speed_m_s=0.4, for_s=1.0): call.school.startle("fish", 0.4, 1.0),
}


def test_each_kind_of_fault_does_one_thing_to_the_dive():
    assert {type(fault).__struct_config__.tag for fault in DONE} == set(KINDS)
    for fault, done in DONE.items():
        dive = Mock(spec=[*dir(Dive), "gyros", "school"])
        apply(fault, dive)
        assert dive.mock_calls == [done]


# --- between the water and the firmware ---------------------------------------------------------------------------


def test_sensors_die_stick_lie_and_get_well():
    made = boardless_dive()
    run(made, 10)
    before = readings_m(made)
    made.kill_sensor("r1", 1)
    made.stick_sensor("r1", 2)
    made.shift_sensor("r1", 3, 0.05)
    run(made, 10)
    stuck = made._readings_pa[0][1]
    run(made, 10)
    after = readings_m(made)
    assert made._readings_pa[0][0] == 0.0 and made.sensor_faults.answered[0] == 0b1110
    assert made._readings_pa[0][1] == stuck and after[1] == pytest.approx(before[1])
    assert after[2] - before[2] == pytest.approx(0.05, abs=8 * NOISE_M)
    np.testing.assert_allclose(readings_m(made, 1), 0.4, atol=8 * NOISE_M)  # the other robot is well
    for sensor in (1, 2, 3):
        made.mend_sensor("r1", sensor)
    run(made, 2)
    np.testing.assert_allclose(readings_m(made), 0.4, atol=8 * NOISE_M)
    assert made.sensor_faults.answered[0] == ALL_SENSORS
    with pytest.raises(ValueError, match="they are 1 to 4"):
        made.kill_sensor("r1", 0)


def test_a_leak_is_told_to_one_board():
    made = boardless_dive()
    run(made, 1)
    made.leak("r2")
    run(made, 1)
    assert [[tick[5] for tick in board.ticks] for board in made.boards] == [[False, False], [False, True]]


def test_the_battery_sags_under_thrust_and_thrust_with_the_battery():
    made = boardless_dive()
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
    made = boardless_dive()
    made.scale_thruster("r1", 3, 0.0)
    made.scale_thruster("r1", 8, -1.0)
    made._pulses_us[:] = 1700.0
    for _ in range(100):
        made.move()
    thrust_n = made.states["thrust_n"]
    assert thrust_n[0, 2] == 0 and thrust_n[0, 7] < -1 and thrust_n[0, 0] > 1
    assert np.all(thrust_n[1] > 1)
