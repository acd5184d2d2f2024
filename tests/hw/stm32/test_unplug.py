"""The serial cable pulled and put back: what the robot does meanwhile, and what brings it back to work."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.clock.clock import RunClock
from agent.core.config import dump
from agent.core.step_io import Telemetry
from hw.firmware import failsafe
from hw.stm32.driver import Stm32
from hw.twin.scene import PowerCut, SerialUnplug
from tests.hw.firmware.diving_robot import ASCENT_M_S, FLEET, HOVER, diving_robot
from tests.places import ROOT
from tests.waiting import until


def test_one_second_without_a_cable_is_over_as_soon_as_it_is_back(tmp_path):
    with diving_robot(tmp_path, [SerialUnplug(at_s=10.0, robot="r1", for_s=1.0)]) as robot:
        robot.arm()
        robot.run(10.9 - robot.dive.now_ns * 1e-9)
        assert not robot.board.port.exists()
        heard = len(robot.telemetry)
        robot.run(0.5)
        assert robot.board.port.exists() and robot.protocol.counters.reconnects == 1
        assert len(robot.telemetry) > heard
        robot.run(0.5)
        assert robot.armed and robot.ladder == failsafe.OK
        assert abs(robot.depth_m - HOVER.depth_m) < 0.01 and robot.tilt_deg < 1.0


def test_after_five_seconds_it_is_on_its_way_up_and_an_order_calls_it_back(tmp_path):
    with diving_robot(tmp_path, [SerialUnplug(at_s=10.0, robot="r1", for_s=5.0)]) as robot:
        robot.arm()
        robot.run(12.9 - robot.dive.now_ns * 1e-9)
        assert abs(robot.depth_m - HOVER.depth_m) < 0.01  # it holds
        robot.run(2.1)
        assert HOVER.depth_m - robot.depth_m == pytest.approx(2.0 * ASCENT_M_S, abs=0.03)
        boot_id = robot.protocol._boot_id
        robot.run(0.5)
        assert robot.protocol._boot_id == boot_id
        assert robot.armed and robot.protocol.wants_armed  # nothing disarmed it
        assert robot.ladder == failsafe.SURFACE
        higher_m = robot.depth_m
        robot.run(1.0)
        assert robot.depth_m < higher_m - 0.04  # set-points alone do not call it back
        robot.protocol.arm()
        robot.run(2.5)
        assert robot.ladder == failsafe.OK and robot.armed
        assert abs(robot.depth_m - HOVER.depth_m) < 0.01


def test_a_cable_that_is_back_too_late_finds_a_robot_at_the_surface(tmp_path):
    with diving_robot(tmp_path, [SerialUnplug(at_s=10.0, robot="r1", for_s=12.0)]) as robot:
        robot.arm()
        robot.run(22.5 - robot.dive.now_ns * 1e-9)
        assert not robot.armed and robot.telemetry[-1].ladder == failsafe.DISARM
        assert not robot.protocol.wants_armed and robot.heard("the board has disarmed")


def test_a_power_cut_ends_in_a_new_boot_that_nobody_arms(tmp_path):
    with diving_robot(tmp_path, [PowerCut(at_s=10.0, robot="r1", for_s=2.0)]) as robot:
        robot.arm()
        robot.run(10.5 - robot.dive.now_ns * 1e-9)
        boot_id = robot.protocol._boot_id
        assert (robot.dive._pulses_us == 0).all() and not robot.board.port.exists()
        robot.run(6.0)
        assert robot.protocol._boot_id != boot_id and robot.heard("the board has restarted; arm again")
        assert not robot.armed and not robot.protocol.wants_armed
        robot.protocol.arm()
        robot.until(lambda: robot.armed, 5.0)


SCENE = """
name = "pulled"
[[solid]]
kind = "ball"
position_m = [0.76, 0.56, 0.07]
radii_m = [0.07, 0.07, 0.07]
[[event]]
at_s = AT
kind = "serial_unplug"
robot = "r1"
for_s = 4.0
"""
READY_S = 60.0  # on a fresh machine the physics is compiled first
PULLED_S = 7.0  # of the twin's clock: arming takes 3.5 s


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Path]:
    """The folder of a twin process whose scene pulls r1's cable."""
    scene = tmp_path / "pulled.toml"
    scene.write_text(SCENE.replace("AT", str(PULLED_S)))
    folder = tmp_path / "twin"
    fleet = replace(
        FLEET,
        robot={"r1": replace(FLEET.robot["r1"], camera="twin:r1")},
        twin=replace(FLEET.twin, scene=str(scene), dir=str(folder)),
    )
    path = tmp_path / "fleet.toml"
    path.write_text(dump(fleet))
    process = subprocess.Popen([sys.executable, "-m", "hw.twin", str(path)], cwd=ROOT)
    try:
        until(lambda: (folder / "ready").exists() or process.poll() is not None, READY_S)
        assert process.poll() is None
        yield folder
    finally:
        process.terminate()
        process.wait()


@pytest.mark.slow
def test_the_driver_and_a_running_twin_find_each_other_again(twin):
    """The wall clock and the driver's own thread: four seconds without a cable, then back at depth."""
    with Stm32(str(twin / "r1.serial"), RunClock(twin / "clock")) as driver:
        seen: list[Telemetry] = []

        def drive(what: str, done: Callable[[], bool], limit_s: float) -> float:
            start_s = time.monotonic()
            while not done():
                assert time.monotonic() - start_s < limit_s, f"{what}: {seen[-1:]} {driver.counters}"
                driver.send(HOVER, time.time_ns())
                seen.extend(driver.drain()[0])
                time.sleep(0.05)
            return time.monotonic() - start_s

        driver.arm()
        drive("armed", lambda: bool(seen) and seen[-1].armed, 20.0)
        drive("pulled", lambda: not (twin / "r1.serial").exists(), 20.0)
        before = seen[-1]
        drive("back", lambda: driver.counters.reconnects == 1 and seen[-1].t_ns > before.t_ns + 3_000_000_000, 20.0)
        after = seen[-1]
        assert after.armed and driver.wants_armed and after.ladder == failsafe.SURFACE
        assert after.board_us > before.board_us  # the same boot
        assert before.depth_m == pytest.approx(HOVER.depth_m, abs=0.01)
        assert after.depth_m < before.depth_m - 0.03  # a second of the ascent
        driver.arm()
        drive("at work", lambda: seen[-1].ladder == failsafe.OK, 5.0)
        drive("at depth", lambda: abs(seen[-1].depth_m - HOVER.depth_m) < 0.01, 10.0)
        assert seen[-1].armed
