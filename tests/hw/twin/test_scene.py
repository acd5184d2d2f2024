"""Creatures in a dive: what is kept of them, what is told, and that robots' own chances are as without them."""

import csv
import math
import re
from pathlib import Path
from unittest.mock import Mock, call

import msgspec
import numpy as np
import pytest

from agent.core.config import ConfigError
from agent.robot.fleet_reader import load_fleet
from hw.camera.camera import Roi
from hw.twin.board import ALL_SENSORS, BATTERY_MV, CURRENT_10MA, Act
from hw.twin.camera_device import DiveCamera, FrameClock, burning
from hw.twin.creatures import Attitude, Lookout, swimming
from hw.twin.dive import Dive, RobotPose, apply
from hw.twin.optics.image_formation import FRAME_NS
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Outline, Painter
from hw.twin.optics.raycast import Eye, Moment
from hw.twin.physics.body import GIMBAL_CAMERA, NOMINAL_V, OHM, gimbal
from hw.twin.physics.sensors import NOISE_M, PROBE_NOISE_MV, BatteryProbes
from hw.twin.physics.tank import TICK_NS
from hw.twin.scene import (
    KINDS,
    SCENES,
    Battery,
    CastOff,
    Creature,
    Crossed,
    Current,
    CurrentSet,
    FirmwareHang,
    GyroDead,
    GyroStuck,
    KillSwitch,
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
    Solid,
    Startle,
    TagLost,
    TetherPull,
    ThrusterDead,
    ThrusterGain,
    generator,
    in_daylight,
    lamp_place,
    load_scene,
    target_solids,
)
from tests.hw.twin.stand_ins import boardless_dive, readings_m, run
from tests.hw.twin.test_camera_device import Notebook
from tests.places import ROOT

FLEET = load_fleet(Path(__file__).parent / "swim.toml")
SCENE = load_scene("fish")


def dived(scene, ticks):
    dive = Dive(FLEET, list(FLEET.robot), 0, scene=scene)
    dive.states["held"] = 0
    for _ in range(ticks):
        dive.tick(0.0)
    return dive


def test_robots_are_where_they_are_without_creatures():
    alone = dived(msgspec.structs.replace(SCENE, creature=()), 60)
    together = dived(SCENE, 60)
    assert alone.states.tobytes() == together.states.tobytes()
    assert alone._readings_pa == together._readings_pa
    assert not alone.school and alone.history.creatures_at(0) == []


def test_the_current_takes_a_creature_along():
    flowing = msgspec.structs.replace(SCENE, current=Current(velocity_m_s=(0.1, 0.0, 0.0)))
    still = msgspec.structs.replace(SCENE, current=Current())
    with_it, without = (np.array(dived(scene, 60).school.attitudes[0][:3]) for scene in (flowing, still))
    np.testing.assert_allclose(with_it - without, (0.06, 0.0, 0.0), atol=0.01)


def test_cameras_see_a_creature_where_it_was_then():
    dive = dived(SCENE, 60)
    assert dive.history.creatures_at(60 * TICK_NS) == dive.school.attitudes
    before, between, after = (
        np.array(dive.history.creatures_at(t_ns)[0]) for t_ns in (300_000_000, 302_500_000, 310_000_000)
    )
    np.testing.assert_allclose(between, before + 0.25 * (after - before))
    notebook, told = Notebook(), []
    notebook.outlines = lambda moment, distance_m: [Outline("fish", (0, 0, 1, 1), 1, 1)]
    lens = draw_lens(SCENE.camera, np.random.default_rng(0))
    where = (dive.history, lens, notebook, notebook, (0.1, 0.0, 0.0), dive.stage, FrameClock(0), lambda: 0)
    camera = DiveCamera(0, *where, creatures=SCENE.creature, witness=lambda *row: told.append(row))
    camera._frame(7, 302_500_000, None)
    (seen,) = notebook.moments[-1].creatures
    middle_m = np.array([part.position_m for part in seen.parts[:6]]).mean(0)
    assert np.linalg.norm(middle_m - between[:3]) < 0.01
    assert [row[:2] for row in told] == [(302_500_000, 7)]


def test_a_startle_is_of_a_creature_that_is_there():
    startle = Startle(at_s=0.1, creature="fish", speed_m_s=0.5, for_s=1.0)
    dive = dived(msgspec.structs.replace(SCENE, event=(startle,)), 60)
    way_m = np.subtract(dive.school.attitudes[0][:3], dive.history.creatures_at(50 * TICK_NS)[0][:3])
    assert np.linalg.norm(way_m) / 0.1 == pytest.approx(0.5, rel=0.05)
    nobody = msgspec.structs.replace(startle, creature="whale")
    with pytest.raises(ConfigError, match="no creature 'whale'; name one of fish"):
        dived(msgspec.structs.replace(SCENE, event=(nobody,)), 0)


def test_the_truth_is_written_for_who_judges(tmp_path):
    dive = dived(SCENE, 0)
    dive.lookout = lookout = Lookout(["fish"], tmp_path)
    for _ in range(20):
        dive.tick(0.0)
    lookout.frame("r1", 5, 3, [Outline("fish", (1, 2, 3, 4), 10, 4)])
    lookout.close()
    lookout.frame("r1", 6, 4, [])  # a camera that is late
    rows = list(csv.DictReader((tmp_path / "creatures.csv").read_text().splitlines()))
    assert [int(row["t_ns"]) for row in rows] == [50_000_000, 100_000_000, 150_000_000, 200_000_000]
    names = ("x_m", "y_m", "z_m", "heading_rad", "pitch_rad")
    assert [float(rows[-1][name]) for name in names] == pytest.approx(dive.school.attitudes[0][:5], abs=1e-5)
    assert (tmp_path / "boxes.csv").read_text().splitlines()[1:] == ["5,r1,3,fish,1,2,3,4,10,4"]


# --- outline ---
# What a frame shows of a creature, and what the truth says that it shows.

FISH, TWO = Creature(name="fish"), Creature(name="two", colour="silver")
LENS = draw_lens("imx519_640", np.random.default_rng(1))
EYE = Eye(np.array((0.6, 0.8, 0.2)), gimbal(0, 0) @ GIMBAL_CAMERA)
V = LENS.at_rest_m
AT = Attitude(1.15, 0.8, 0.22, math.pi / 2, 0.0, 1.0, 1.0)


@pytest.fixture(scope="module")
def painter():
    painter = Painter(Scene(name="bare", creature=(FISH, TWO)), FLEET.tank, 1.333, LENS, 0, "r1")
    painter.prepare()
    return painter


def moment(*attitudes, solids=()):
    creatures = zip((FISH, TWO), attitudes, strict=False)
    return Moment(EYE, solids, creatures=tuple(swimming(who, how, 0) for who, how in creatures))


def changed(painter, what, without):
    """Rows and columns of the pixels that differ by more than noise can."""
    seen, bare = (painter.expose(each, V).astype(int) for each in (what, without))
    return np.nonzero(np.abs(seen - bare).max(2) > 40)


def test_what_it_covers_is_the_box_of_the_truth(painter):
    (shown,) = painter.outlines(moment(AT), V)
    rows, columns = changed(painter, moment(AT), moment())
    x0, y0, x1, y1 = shown.box
    assert shown.visible == shown.pixels > 5000
    assert len(rows) > 0.6 * shown.visible
    blur = 6  # px, of the lens at rest at this range
    assert x0 - blur <= columns.min() < x0 + blur and x1 - blur <= columns.max() < x1 + blur
    assert y0 - blur <= rows.min() < y0 + blur and y1 - blur <= rows.max() < y1 + blur


def test_its_length_is_seen_at_the_pinhole_scale(painter):
    straight = AT._replace(width=0.0)
    (shown,) = painter.outlines(moment(straight), V)
    focal_px = 1.333 * V / LENS.pixel_m
    assert shown.box[2] - shown.box[0] == pytest.approx(focal_px * 0.15 / 0.55, rel=0.03)


def test_behind_a_stone_nothing_shows_and_the_truth_says_so(painter):
    stone = Solid(kind="stone", position_m=(0.95, 0.8, 0.2), radii_m=(0.05, 0.16, 0.12))
    (hidden,) = painter.outlines(moment(AT, solids=(stone,)), V)
    assert hidden.visible == 0 and hidden.pixels > 5000
    with_it, without = (painter.expose(moment(*at, solids=(stone,)), V, tick=3) for at in ((AT,), ()))
    assert with_it.tobytes() == without.tobytes()
    half = msgspec.structs.replace(stone, position_m=(0.95, 0.96, 0.2))
    (shown,) = painter.outlines(moment(AT, solids=(half,)), V)
    assert 0.2 < shown.visible / shown.pixels < 0.8


def test_one_in_front_of_the_other_hides_it_and_who_is_out_of_the_frame_is_not_told(painter):
    first, second = painter.outlines(moment(AT, AT._replace(x_m=1.3)), V)
    assert (first.name, second.name) == ("fish", "two")
    assert second.visible < 0.2 * second.pixels
    assert not painter.outlines(moment(AT._replace(x_m=0.2)), V)


def test_a_passing_one_is_smeared_and_what_rests_is_not(painter):
    def passing(share):
        return moment(AT._replace(y_m=0.8 + 0.004 * share))

    still, moving = (painter.expose(moment(AT), V, None, 0, during) for during in (None, passing))
    (shown,) = painter.outlines(moment(AT), V)
    x0, y0, x1, y1 = shown.box
    differs = np.abs(still.astype(int) - moving).max(2) > 12  # the noise of both is the same
    assert differs[y0:y1, x0:x1].sum() > 500
    assert not differs[:, : x0 - 30].any() and not differs[:, x1 + 30 :].any()


# --- lamp in the dive ---
# From a robot's pin to the light in another's camera.

SWIM = ROOT / "tests" / "hw" / "twin" / "swim.toml"
PART = Roi(200, 160, 240, 160)


@pytest.fixture(scope="module")
def seen() -> dict[bool, tuple[float, int]]:
    """Mean byte of a frame of r1 and when its middle was after the shutter opened, with r2's lamp on and off."""
    fleet, scene = load_fleet(SWIM), load_scene("harbour")
    robots = list(fleet.robot)
    lens = draw_lens(scene.camera, generator(0, "r1", "lens"))
    painter = Painter(scene, fleet.tank, 1.333, lens, 0, "r1")
    painter.prepare()
    found = {}
    for on in (False, True):
        dive = Dive(fleet, robots, 0, scene=scene)
        servos = (1500, 1500, 1500, 1500)
        for i in range(len(robots)):
            dive._show(i, Act(0, (1500,) * 8, servos, 1000 if on else 0, False))
        for _ in range(30):
            dive.move()
        vcm = Vcm(lens, generator(0, "r1", "vcm"))
        clock = FrameClock(100_000_000)
        place = fleet.body.camera_m
        camera = DiveCamera(
            0,
            dive.history,
            lens,
            vcm,
            painter,
            place,
            dive.stage,
            clock,
            lambda: 100_000_000,
            lamp_m=lamp_place(fleet, scene),
        )
        camera.set_focus(300)
        frame = camera.read(PART, 0.0)
        found[on] = float(frame.image.mean()), frame.t_ns - clock.opens_ns(frame.seq)
        if on:
            assert dive.history.at(200_000_000)[1].lamp == pytest.approx(1.0, abs=0.06)
            assert dive._drawn_a[0] > 2.0  # a lamp's ampere beside the electronics
    return found


def test_a_pin_lights_the_tank(seen: dict[bool, tuple[float, int]]) -> None:
    assert seen[True][0] > 1.5 * seen[False][0]


def test_a_frame_is_stamped_with_the_middle_of_its_own_exposure(seen: dict[bool, tuple[float, int]]) -> None:
    assert seen[False][1] == FRAME_NS // 2  # black: as long as it can be
    assert 0 < seen[True][1] <= FRAME_NS // 2


def test_a_lamp_turns_with_its_gimbal_and_its_robot() -> None:
    level = RobotPose(np.array([1.0, 1.0, 0.3]), np.eye(3), 0.0, 0.0, lamp_pan_deg=90.0, lamp=0.5)
    lamp = burning(level, (0.1, 0.12, 0.0))
    assert np.allclose(lamp.position_m, (1.1, 1.12, 0.3)) and np.allclose(lamp.aim, (0, 1, 0)) and lamp.power == 0.5
    tilted = burning(level._replace(lamp_pan_deg=0.0, lamp_tilt_deg=30.0), (0.1, 0.12, 0.0))
    assert np.allclose(tilted.aim, (np.cos(np.pi / 6), 0, 0.5))


def test_cameras_are_calibrated_in_daylight_and_old_scenes_have_no_lamps() -> None:
    fleet = load_fleet(SWIM)
    dark = load_scene("harbour")
    assert in_daylight(dark).room_light > 0 and in_daylight(dark).water.absorption_per_m is None
    tank = load_scene("tank")
    assert in_daylight(tank) is tank and lamp_place(fleet, tank) is None


# --- faults ---
# Faults on demand: scene files that ask for them, and what sensors, leak probe, battery and thrusters then do.


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
        "crossed": 'what = "sensors"\npair = [1, 3]',
        "kill_switch": 'to = "broken"',
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
    assert len(scene.event) == len(kinds) == 23
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
        ('kind = "sensor_offset"\nsensor = 1\noffset_m = nan', r"'event\[0\]\.offset_m': not a finite number"),
        ('kind = "serial_unplug"\nfor_s = inf', r"'event\[0\]\.for_s': not a finite number"),
        ('kind = "thruster_gain"\nthruster = 1\ngain = 1e300', r"'event\[0\]\.gain': 1e\+300 is beyond"),
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
    Crossed(at_s=0, robot="r1", what="sensors", pair=(1, 3)): call.cross_sensors("r1", 1, 3),
    KillSwitch(at_s=0, robot="r1", to="broken"): call.turn_kill_switch("r1", "broken"),
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
    millivolts, drawn_10ma = made.boards[0].ticks[-1][3:5]
    assert drawn_10ma == CURRENT_10MA and millivolts == pytest.approx(BATTERY_MV, abs=200)
    made._pulses_us[0], made.boards[0].driving = 1900.0, True
    run(made, 200)
    amperes, volts = made._drawn_a[0], made.supply_v[0]
    assert volts == pytest.approx(NOMINAL_V - OHM * (amperes - CURRENT_10MA / 100))
    assert 12.0 < volts < 13.0
    full_n = made.states["thrust_n"][0].sum()
    assert made.boards[0].ticks[-1][3] == pytest.approx(1000 * volts, abs=200)
    made.set_battery("r1", 12.0)
    run(made, 200)
    assert made.states["thrust_n"][0].sum() < 0.85 * full_n


def test_a_batterys_probe_is_noisy_and_says_no_less_than_nothing():
    probes = BatteryProbes(3, ["r1", "r2"])
    told = np.array([probes.read_mv(np.array([14.8, 0.0])) for _ in range(4000)])
    assert told[:, 0].std() == pytest.approx(PROBE_NOISE_MV, rel=0.05)
    assert told[:, 0].mean() == pytest.approx(14_800, abs=5) and told[:, 1].min() == 0
    assert np.diff(np.unique(told[:, 0])).min() >= 8, "a converter has steps"


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


# --- scene page ---
# docs/scenes.md says what a scene file can say, and all of it can be said.

PAGE = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")


def test_the_scene_of_the_page_is_one(tmp_path):
    text = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)[0]
    path = tmp_path / "scene.toml"
    path.write_text(text)
    scene = load_scene(str(path))
    assert not [key for key in scene.__struct_fields__ if not re.search(rf"^\[*{key}\b", text, re.MULTILINE)]
    Dive(load_fleet(SWIM), ["r1", "r2", "r3"], 0, scene=scene).move()


def test_every_event_and_every_scene_is_on_the_page():
    assert not [kind for kind in KINDS if f"`{kind}`" not in PAGE]
    assert not [path.stem for path in SCENES.glob("*.toml") if f"`{path.stem}`" not in PAGE]


def test_the_scene_that_ships_suits_a_fleet_that_swims():
    fleet, scene = load_fleet(SWIM), load_scene("swim")
    (ball,) = target_solids(fleet, scene, SWIM).values()
    assert all(0 < place < size for place, size in zip(ball.position_m, fleet.tank.size_m, strict=True))
    dive = Dive(fleet, list(fleet.robot), 0, scene=scene)
    dive.states["held"] = 0
    for _ in range(200):
        dive.move()
    assert not dive.bodies["mooring"].any() and dive._flow.active
    assert (abs(dive.states["position_m"][:, :2] - dive.bodies["home_m"][:, :2]) > 1e-4).any(axis=1).all()
    assert [tag.id for tag in dive.stage.tags(0)] == [0, 1, 12, 211, 586]
