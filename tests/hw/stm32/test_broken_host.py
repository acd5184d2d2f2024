"""The end of a host: broken, it lets its robot go up under control; asked to stop, it switches the motors off."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import pytest

from agent.clock.clock import SystemClock
from hw.firmware import wire
from hw.stm32.driver import Stm32
from hw.twin.dive import LOCK_STEP_S
from tests.hw.firmware.diving_robot import HOST, HOVER, SURFACED_M, diving_robot
from tests.hw.stm32.driven_desk import Port, drive
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
