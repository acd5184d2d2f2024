"""From a robot's pin to the light in another's camera."""

import numpy as np
import pytest

from agent.robot.fleet_reader import load_fleet
from hw.camera.camera import Roi
from hw.twin.board import Act
from hw.twin.camera_device import DiveCamera, FrameClock, burning
from hw.twin.dive import Dive, RobotPose
from hw.twin.optics.image_formation import FRAME_NS
from hw.twin.optics.lens import Vcm, draw_lens
from hw.twin.optics.painter import Painter
from hw.twin.scene import generator, in_daylight, lamp_place, load_scene
from tests.places import ROOT

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
