"""The end of a host: broken, it lets its robot go up under control; asked to stop, it switches the motors off."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.clock.clock import RunClock, SystemClock
from agent.core.config import dump
from agent.core.step_io import Telemetry
from hw.firmware import failsafe, wire
from hw.stm32.driver import Stm32
from hw.twin.dive import LOCK_STEP_S
from hw.twin.scene import PowerCut, SerialUnplug
from tests.hw.firmware.diving_robot import ASCENT_M_S, FLEET, HOST, HOVER, SURFACED_M, diving_robot
from tests.hw.stm32.driven_desk import Port, drive
from tests.places import ROOT
from tests.waiting import until


class BoardTime:
    """Lets the board's time pass while the driver waits for an answer."""

    def __init__(self, desk) -> None:
        self.desk, self.stop = desk, threading.Event()
        self.thread = threading.Thread(target=self.run)

    def run(self) -> None:
        while not self.stop.is_set():
            self.desk.tick()
            time.sleep(0.002)

    def __enter__(self) -> None:
        self.thread.start()

    def __exit__(self, *_) -> None:
        self.stop.set()
        self.thread.join()


@pytest.fixture
def desk(put_on_desk):
    desk = put_on_desk(sys.executable)
    desk.listen = lambda: None  # the driver reads the tether, not the desk
    return desk


@pytest.fixture
def port(desk, tmp_path):
    return Port(desk, tmp_path)


def pulses_after(desk, port, error: BaseException | None) -> tuple[int, ...]:
    """Pins one second after a host with an armed board has left its block so."""
    driver = Stm32(str(port.path), SystemClock())
    driver.__enter__()
    driver.arm()
    drive(desk, driver, lambda: bool(desk.tick()[-1]))
    with BoardTime(desk):
        driver.__exit__(type(error) if error else None, error, None)
    return desk.tick(100)


def test_with_an_exception_the_robot_goes_up_and_is_not_switched_off(desk, port):
    pins = pulses_after(desk, port, RuntimeError("the agent is broken"))
    assert pins[-1] == wire.ARMED and min(pins[1:5]) > 1550, "a second without set-points, and on its way up"


@pytest.mark.parametrize("error", [None, KeyboardInterrupt(), SystemExit(0)], ids=["none", "Ctrl-C", "exit"])
def test_whoever_asks_for_the_end_switches_the_motors_off(desk, port, error):
    pins = pulses_after(desk, port, error)
    assert pins[-1] == wire.DISARMED and pins[1:9] == (1500,) * 8


def test_on_the_bench_a_broken_host_stops_the_thruster(desk, port):
    """Mode surface is refused there, and half a second without a set-point is the end anyway."""
    driver = Stm32(str(port.path), SystemClock())
    driver.__enter__()
    drive(desk, driver, lambda: driver.greeting is not None)
    driver.mode("bench", 3)
    driver.arm()
    drive(desk, driver, lambda: desk.tick()[3] == 1560)
    with BoardTime(desk):
        driver.let_surface()
    assert desk.tick(60)[1:9] == (1500,) * 8


def test_nobody_there_to_hear_the_order_is_waited_for_no_longer_than_at_any_end(desk, port):
    driver = Stm32(str(port.path), SystemClock())
    driver.__enter__()
    drive(desk, driver, lambda: driver.counters.rx_ok > 10)
    start_s = time.monotonic()
    driver.let_surface()
    assert time.monotonic() - start_s < 2.0 and driver._thread is None


def test_a_tap_that_raises_ends_the_recording_of_the_tether_and_not_the_driver(desk, port):
    taken = []

    def tap(from_board: bool, chunk: bytes) -> None:
        taken.append(chunk)
        raise OSError(28, "No space left on device")

    with Stm32(str(port.path), SystemClock(), tap=tap) as driver:
        driver.arm()
        drive(desk, driver, lambda: bool(desk.tick()[-1]))
        assert len(taken) == 1 and driver.counters.reconnects == 0
        assert any("no longer recorded: OSError" in text for text in desk.said)


def test_a_fault_of_the_driver_itself_is_told_and_the_port_opened_again(desk, port):
    with Stm32(str(port.path), SystemClock()) as driver:
        drive(desk, driver, lambda: driver.counters.rx_ok > 10)
        receive, broken = driver._protocol.receive, threading.Event()

        def receive_once(chunk: bytes, now_ns: int) -> None:
            if not broken.is_set():
                broken.set()
                raise IndexError("on purpose")
            receive(chunk, now_ns)

        driver._protocol.receive = receive_once
        driver.arm()
        drive(desk, driver, lambda: bool(desk.tick()[-1]), ticks=3000)
        assert driver.counters.reconnects == 1
        assert any("the driver broke off: IndexError: on purpose" in text for text in desk.said)


def test_a_host_that_breaks_leaves_a_robot_that_goes_up_level_at_once(tmp_path):
    """Real driver, real firmware, the twin's water, which runs at most three times as fast as the host's clock."""
    with diving_robot(tmp_path) as robot:
        command = [sys.executable, "-c", textwrap.dedent(HOST), str(robot.board.port)]
        host = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        assert host.stdout is not None
        try:
            os.set_blocking(host.stdout.fileno(), False)

            def water(ticks: int) -> None:
                for _ in range(ticks):
                    robot.dive.tick(LOCK_STEP_S)
                    time.sleep(0.003)

            def is_armed() -> bool:
                water(10)
                return b"armed" in (host.stdout.read() or b"")

            until(is_armed)
            water(300)
            assert abs(robot.depth_m - HOVER.depth_m) < 0.01
            host.send_signal(signal.SIGUSR1)
            start_m, worst_deg = robot.depth_m, 0.0
            water(250)  # the ladder alone would hold until three seconds of silence have passed
            assert host.poll() == 1
            assert start_m - robot.depth_m > 0.05
            for _ in range(1500):
                robot.dive.tick(LOCK_STEP_S)
                worst_deg = max(worst_deg, robot.tilt_deg)
                if robot.depth_m < SURFACED_M and robot.thrust_n.max() < 0.01:
                    break
            assert robot.depth_m < SURFACED_M and robot.thrust_n.max() < 0.01, "up, and its motors off"
            assert worst_deg < 2.0
        finally:
            host.kill()
            host.wait()
            host.stdout.close()


# --- unplug ---
# The serial cable pulled and put back: what the robot does meanwhile, and what brings it back to work.


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
