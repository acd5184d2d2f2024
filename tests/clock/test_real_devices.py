"""Robots with real devices live by the system's clock: a serial port that is a pty, a V4L2 camera that is a stand-in.

Nothing of a twin takes part, not even one that runs in the folder where theirs would be.
"""

import sys
import time

import msgspec
import pytest

from agent.clock.clock import SystemClock
from agent.clock.keeper import start_clock
from agent.core.config import Fleet
from agent.core.ranging.camera_model import CameraFit
from agent.core.step_io import SweepPlan
from agent.perception.detection.detectors import load_detectors
from agent.perception.vision import Vision
from agent.process.command import shipped_fleet
from agent.process.transport import fleet_clock
from agent.robot.fleet_reader import load_fleet
from hw.stm32.driver import Stm32
from hw.twin.twin_folder import clock_path
from tests.hw.camera.fake_v4l2 import FakeComputer
from tests.hw.conftest import put_on_desk  # noqa: F401 - a fixture
from tests.hw.stm32.driven_desk import Port, drive
from tests.sightings import collect

CAMERA = CameraFit(width_px=96, height_px=64, f_px=150.0, cx_px=47.5, cy_px=31.5)


@pytest.fixture
def real_fleet(tmp_path) -> Fleet:
    """The shipped fleet with real devices; an hour ahead, a twin keeps time in its folder."""
    fleet = load_fleet(shipped_fleet())
    replace = msgspec.structs.replace
    robots = {
        name: replace(robot, serial=f"/dev/ttyACM{i}", camera=f"v4l2:/dev/video{i}")
        for i, (name, robot) in enumerate(fleet.robot.items())
    }
    fleet = replace(fleet, robot=robots, twin=replace(fleet.twin, dir=str(tmp_path)))
    start_clock(clock_path(fleet), list(robots), time.time_ns() + 3_600_000_000_000, 1.0, 10_000_000)
    return fleet


def is_now(t_ns: int) -> bool:
    return abs(t_ns - time.time_ns()) < 5_000_000_000


def test_a_control_module_on_a_port_is_stamped_with_the_time_of_day(real_fleet, put_on_desk, tmp_path):  # noqa: F811
    clock = fleet_clock(real_fleet)
    assert isinstance(clock, SystemClock) and is_now(clock.now_ns())
    desk = put_on_desk(sys.executable)
    desk.listen = lambda: None  # the driver reads the tether, not the desk
    with Stm32(str(Port(desk, tmp_path).path), clock, part="r1.serial") as driver:
        driver.arm()
        telemetry = drive(desk, driver, lambda: driver._protocol.armed)
    assert telemetry and all(is_now(t.t_ns) for t in telemetry)


def test_frames_of_a_camera_are_stamped_by_its_driver_and_told_in_the_time_of_day(real_fleet):
    computer = FakeComputer()
    clock = fleet_clock(real_fleet)
    vision = Vision(computer.open, real_fleet, CAMERA, load_detectors(real_fleet, CAMERA), clock, "r1")
    vision.start()
    try:
        vision.plan(SweepPlan(sweep=1, focus=(0, 5, 10)))
        seen = collect(vision, lambda seen: any(s.sweep == 1 for s in seen), 30.0)
    finally:
        vision.close()
    offset_ns = time.time_ns() - time.monotonic_ns()
    driver_ns = [s.t_ns - offset_ns for s in seen]  # the stand-in's own time, which began at 5 s
    assert all(4_900_000_000 < t_ns < 60_000_000_000 for t_ns in driver_ns)
