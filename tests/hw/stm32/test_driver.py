"""The host driver against the real firmware, through a pty that may come late, go away, or take nothing."""

from __future__ import annotations

import os
import sys
import threading
import time
import tty
from collections.abc import Callable

import pytest

from agent.clock.clock import RunClock, SystemClock
from agent.clock.keeper import start_clock
from agent.core.config import ConfigError
from agent.core.step_io import Telemetry
from hw.firmware import failsafe, wire
from hw.firmware.failsafe import DISARM, HOLD, LATCHED, OK, SURFACE
from hw.module import AGAIN_NS, ARM_WITHIN_NS, Level, Motors, surfacing_for_silence
from hw.stm32 import open_module, serial_port
from hw.stm32.driver import Stm32
from tests.hw.stm32.driven_desk import HOVER, Port, drive
from tests.robot.ordering import Ordering
from tests.sample_messages import telemetry
from tests.waiting import until


@pytest.fixture
def desk(put_on_desk):
    return put_on_desk(sys.executable)


@pytest.fixture
def port(desk, tmp_path):
    desk.listen = lambda: None  # the driver reads the tether, not the desk
    return Port(desk, tmp_path)


@pytest.fixture
def driver(port):
    with Stm32(str(port.path), SystemClock()) as driver:
        yield driver


def armed(driver: Stm32) -> Callable[[], bool]:
    return lambda: driver._protocol.armed


def newest(desk, driver: Stm32) -> Telemetry:
    """What the board shows a few frames from now."""
    heard = driver.counters.rx_ok
    return drive(desk, driver, lambda: driver.counters.rx_ok > heard + 20)[-1]


def stands(desk, driver: Stm32, ladder: int) -> Telemetry:
    """What the board shows once it is there: on a busy machine it misses set-points, and holds for a moment."""
    for _ in range(50):
        shown = newest(desk, driver)
        if shown.ladder == ladder:
            return shown
    raise AssertionError(f"it shows {shown}")


def test_arms_after_waiting_for_the_escs(desk, driver):
    driver.arm()
    drive(desk, driver, armed(driver))
    assert any(text.startswith("arming waits") and "ESC" in text for text in desk.said)
    drive(desk, driver, lambda: bool(desk.tick()[-1]))
    newest = stands(desk, driver, failsafe.OK)
    assert newest.depth_m == pytest.approx(0.3, abs=0.001)
    assert newest.sensor_depth_m == pytest.approx((0.3,) * 4, abs=0.001)
    assert newest.servos_us == HOVER.servos_us
    assert newest.battery_v == pytest.approx(15.0)
    assert newest.flags & wire.FLAG_HELLO
    counters = driver.counters
    assert counters.rx_ok > 100 and counters.rx_bad == counters.lost == counters.reconnects == 0
    assert counters.latency_ns is not None and counters.latency_ns > 0


def test_close_turns_the_motors_off_first(desk, port):
    with pytest.raises(KeyboardInterrupt), Stm32(str(port.path), SystemClock()) as driver:
        driver.arm()
        drive(desk, driver, lambda: bool(desk.tick()[-1]))
        stop = threading.Event()

        def water() -> None:
            while not stop.is_set():
                desk.tick()
                time.sleep(0.002)

        thread = threading.Thread(target=water)
        thread.start()
        try:
            raise KeyboardInterrupt
        finally:
            driver.close()
            stop.set()
            thread.join()
    assert desk.tick()[-1] == wire.DISARMED
    assert desk.tick()[1:9] == (1500,) * 8


def test_close_is_bounded_when_nobody_answers(desk, driver):
    drive(desk, driver, lambda: driver.counters.rx_ok > 10)
    start = time.monotonic()
    driver.close()
    driver.close()
    assert time.monotonic() - start < 2.0


def test_firmware_that_disarms_is_not_armed_again(desk, driver):
    driver.arm()
    drive(desk, driver, armed(driver))
    desk.answered = 0b0011  # two sensors die
    drive(desk, driver, lambda: not driver.wants_armed)
    desk.answered = 0b1111
    drive(desk, driver, lambda: any("two sensors bad" in text for text in desk.said))
    with pytest.raises(AssertionError):
        drive(desk, driver, armed(driver), ticks=500)
    driver.arm()
    drive(desk, driver, armed(driver))


def test_an_ordered_stop_is_latched_in_the_board_until_an_order_to_arm(desk, driver):
    """STOP ALL is the order `stop` to each robot, Start all the order `arm`."""
    robot, motors = Ordering(), Motors(driver, arm=True)
    driver.arm()
    drive(desk, driver, armed(driver))
    robot.run(1.0)
    assert robot.give("stop").ok
    motors.obey(robot.outputs.motors, time.time_ns())
    drive(desk, driver, lambda: not armed(driver)())
    assert desk.tick()[1:9] == (1500,) * 8
    shown = stands(desk, driver, failsafe.LATCHED)
    assert not shown.armed
    motors.feel((shown,), time.time_ns() + 2 * AGAIN_NS)
    with pytest.raises(AssertionError):
        drive(desk, driver, armed(driver), ticks=500)
    robot.run(1.0)
    assert robot.give("arm").ok
    motors.obey(robot.outputs.motors, time.time_ns())
    drive(desk, driver, armed(driver))
    assert stands(desk, driver, failsafe.OK).armed


def test_a_stop_of_another_host_lasts_until_the_board_was_rebooted(desk, port):
    """An agent that is started again, be it with --arm, does not undo what was stopped."""
    with Stm32(str(port.path), SystemClock()) as first:
        first.arm()
        drive(desk, first, armed(first))
        first.emergency_stop()
        drive(desk, first, lambda: not armed(first)())
        assert desk.tick()[1:9] == (1500,) * 8
        stop = threading.Event()
        water = threading.Thread(target=lambda: [desk.tick() for _ in iter(lambda: stop.wait(0.002), True)])
        water.start()
    stop.set()
    water.join()
    with Stm32(str(port.path), SystemClock()) as driver:
        motors = Motors(driver, arm=True)
        motors.obey("arm", time.time_ns())
        drive(desk, driver, lambda: any("fault latched" in text for text in desk.said))
        drive(desk, driver, lambda: motors.fault() is not None)
        stands(desk, driver, failsafe.LATCHED)
        assert any("fault latched; look at the robot, then `aucamp board reboot`" in text for text in desk.said)
        rebooted, before = driver.reboot(), driver.greeting
        drive(desk, driver, lambda: rebooted.done() and driver.greeting != before)
        assert rebooted.result().ok
        motors.obey("arm", time.time_ns())
        drive(desk, driver, armed(driver))
        stands(desk, driver, failsafe.OK)
        driver.disarm()
        drive(desk, driver, lambda: not armed(driver)())


def test_restarted_board_is_not_armed_again(desk, driver):
    driver.arm()
    drive(desk, driver, armed(driver))
    desk.power_off()
    desk.power_on()
    drive(desk, driver, lambda: "the board has restarted; arm again" in desk.said)
    assert not driver.wants_armed
    with pytest.raises(AssertionError):
        drive(desk, driver, armed(driver), ticks=500)


def test_port_that_comes_late_and_is_another_one_later(desk, tmp_path, monkeypatch):
    desk.listen = lambda: None
    path = tmp_path / "r1.serial"
    tries, lost = [], Stm32._lost

    def count(driver: Stm32, level: Level, why: str) -> None:
        lost(driver, level, why)
        tries.append(why)

    monkeypatch.setattr(Stm32, "_lost", count)
    with Stm32(str(path), SystemClock()) as driver:
        driver.send(HOVER, 1)
        driver.arm()
        until(lambda: len(tries) >= 2)  # and is told of once
        assert {line.text for line in driver.drain()[1]} == {f"{path}: No such file or directory"}
        port = Port(desk, tmp_path)
        drive(desk, driver, armed(driver), ticks=3000)
        port.path.unlink()
        _replug(desk, port)
        drive(desk, driver, lambda: driver.counters.reconnects == 1, ticks=3000, send=False)
        drive(desk, driver, lambda: "the board has restarted; arm again" in desk.said)
        assert not driver.wants_armed


def _replug(desk, port: Port) -> None:
    """The board loses power and comes back behind another device file."""
    desk.power_off()
    os.close(desk.slave)
    os.close(desk.master)
    desk.master, desk.slave = os.openpty()
    for fd in (desk.master, desk.slave):
        tty.setraw(fd)
        os.set_blocking(fd, False)
    port.target = os.ttyname(desk.slave)
    port.plug()
    desk.power_on()


def test_refusal_that_waiting_does_not_cure_ends_the_wish(put_on_desk, tmp_path):
    desk = put_on_desk(sys.executable, {})
    desk.listen = lambda: None
    port = Port(desk, tmp_path)
    with Stm32(str(port.path), SystemClock()) as driver:
        driver.arm()
        drive(desk, driver, lambda: not driver.wants_armed)
        assert any("no tare in air" in text for text in desk.said)


def test_send_never_blocks_on_a_board_that_takes_nothing(tmp_path):
    master, slave = os.openpty()
    try:
        with Stm32(os.ttyname(slave), SystemClock()) as driver:
            until(lambda: driver._connected)
            for i in range(20_000):
                driver.send(HOVER, i)
            assert len(driver._waiting) < 2048
    finally:
        os.close(master)
        os.close(slave)


def test_twin_url_and_device_path(tmp_path):
    assert serial_port("twin:r2", tmp_path) == str(tmp_path / "r2.serial")
    by_path = "/dev/serial/by-path/pci-0000:00:14.0-usb-0:1:1.0"
    for url in (by_path, f"stm32:{by_path}"):
        assert serial_port(url, tmp_path) == by_path
        module = open_module(url, tmp_path, SystemClock())
        assert isinstance(module, Stm32) and module.port == by_path
    for wrong in ("twin:", "sub:udp"):
        with pytest.raises(ConfigError, match="twin:ROBOT, stm32:/dev/ttyACM0"):
            open_module(wrong, tmp_path, SystemClock())


def test_a_port_that_a_dead_twin_has_left_is_not_opened(desk, port, tmp_path):
    """Its link still names a pty, and that is somebody else's by now. A twin that comes puts its own there."""
    with Stm32(str(port.path), RunClock(tmp_path / "clock")) as driver:
        lines = until(lambda: driver.drain()[1])
        assert "No such device" in lines[0].text
        desk.tick(20)
        driver.send(HOVER, time.time_ns())
        telemetry, _ = driver.drain()
        assert not telemetry and driver.counters.rx_ok == 0  # what the board says lies there unread
        # Beyond the pause between two attempts, for nobody moves this clock.
        start_clock(tmp_path / "clock", ["r1"], time.time_ns() + 10_000_000_000, 1.0, 10_000_000)
        drive(desk, driver, lambda: driver.counters.rx_ok > 0)


# --- motors ---
# Motors as people want them: what is ordered is told to the module, and told again, and nothing undoes it.

SILENT = {"armed": True, "ladder": SURFACE}


class Board:
    """What a module was told."""

    def __init__(self) -> None:
        self.told: list[str] = []
        self.wants_armed = True

    def arm(self) -> None:
        self.told.append("arm")

    def disarm(self) -> None:
        self.told.append("disarm")

    def emergency_stop(self) -> None:
        self.told.append("off")

    def surface(self) -> None:
        self.told.append("surface")


def feel(motors: Motors, seconds: float, **state) -> None:
    """Telemetry at every step for so long."""
    for step in range(round(seconds * 20)):
        now_ns = 10**12 + step * 50_000_000
        motors.feel((telemetry(now_ns, **state),), now_ns)


@pytest.mark.parametrize(
    ("arm", "ordered", "again"),
    [
        (True, None, "arm"),  # whoever started it with --arm wants the dive to go on
        (False, None, "surface"),  # it was armed by an agent that has gone, and nobody asked this one for motors
        (True, "surface", None),
        (True, "off", "off"),
        (False, "arm", "arm"),
    ],
)
def test_a_robot_that_rises_for_silence_is_called_back_only_where_it_is_wanted_down(arm, ordered, again) -> None:
    board = Board()
    motors = Motors(board, arm)
    if ordered is not None:
        motors.obey(ordered, 0)
    board.told.clear()
    feel(motors, 1.0, **SILENT)
    assert set(board.told) == ({again} if again else set())


def test_an_ordered_surfacing_lasts_to_its_end() -> None:
    board = Board()
    motors = Motors(board, True)
    motors.obey("surface", 0)
    feel(motors, 3.0, **SILENT)
    feel(motors, 3.0, armed=False, ladder=DISARM)
    assert board.told == ["surface"]
    motors.obey("arm", 10**13)
    assert board.told == ["surface", "arm"]


@pytest.mark.parametrize("armed", [True, False])
def test_a_stop_is_said_until_the_module_has_latched(armed: bool) -> None:
    """One that boots, or that no stop has reached, is off but would let itself be armed."""
    board = Board()
    motors = Motors(board, False)
    motors.obey("off", 10**12)
    feel(motors, 1.6, armed=armed, ladder=OK)
    assert board.told == ["off"] * (1 + int(1.55e9 / AGAIN_NS))
    feel(motors, 3.0, armed=False, ladder=LATCHED)
    assert len(board.told) == 1 + int(1.55e9 / AGAIN_NS)


@pytest.mark.parametrize("ordered", ["off", "surface"])
def test_a_module_that_says_nothing_is_told_again(ordered: str) -> None:
    """Its answers are lost, perhaps, and set-points keep it from surfacing by itself."""
    board = Board()
    motors = Motors(board, False)
    motors.obey(ordered, 10**12)
    for step in range(32):
        motors.feel((), 10**12 + step * 50_000_000)
    assert board.told == [ordered] * (1 + int(1.55e9 / AGAIN_NS))


def test_motors_that_nobody_asked_for_are_sent_up_and_an_order_calls_them_back() -> None:
    board = Board()
    motors = Motors(board, False)
    feel(motors, 1.0, armed=False, ladder=OK)
    assert not board.told and motors.fault() is None
    feel(motors, 0.2, armed=True, ladder=OK)
    assert board.told == ["surface"] and "without --arm" in motors.fault()
    motors.obey("arm", 2 * 10**12)
    assert board.told == ["surface", "arm"] and motors.fault() is None


def test_an_order_to_arm_that_came_to_nothing_is_over() -> None:
    """Who pushes home a plug a minute later has a hand there."""
    board = Board()
    motors = Motors(board, False)
    motors.obey("arm", 10**12)
    feel(motors, ARM_WITHIN_NS * 1e-9 - 0.1, armed=False, ladder=OK)
    assert board.told == ["arm"] and motors.fault() is None
    motors.feel((), 10**12 + ARM_WITHIN_NS + 1)  # it need not have been heard
    assert board.told == ["arm", "disarm"] and "order: arm" in motors.fault()
    motors.obey("arm", 2 * 10**12)
    motors.feel((telemetry(0, armed=True, ladder=OK),), 2 * 10**12 + 10**9)
    feel(motors, 20.0, armed=True, ladder=OK)
    assert board.told == ["arm", "disarm", "arm"] and motors.fault() is None


@pytest.mark.parametrize(("ordered", "ladder"), [("off", OK), ("surface", OK), ("surface", HOLD)])
def test_a_module_that_does_not_do_it_is_told_again(ordered: str, ladder: int) -> None:
    board = Board()
    motors = Motors(board, False)
    motors.obey(ordered, 10**12)
    feel(motors, 1.6, armed=True, ladder=ladder)
    assert board.told == [ordered] * (1 + int(1.55e9 / AGAIN_NS))


def test_what_the_module_has_given_up_is_a_fault_only_while_it_is_wanted() -> None:
    board = Board()
    board.wants_armed = False
    motors = Motors(board, True)
    assert "order: arm" in motors.fault()
    motors.obey("off", 0)
    assert motors.fault() is None
    assert Motors(board, False).fault() is None


@pytest.mark.parametrize("flag", [wire.FLAG_LEAK, wire.FLAG_BATTERY, wire.FLAG_DEGRADED])
def test_what_is_for_a_person_to_judge_is_no_silence(flag: int) -> None:
    assert surfacing_for_silence(telemetry(0, **SILENT))
    assert not surfacing_for_silence(telemetry(0, **SILENT, flags=flag))
    assert not surfacing_for_silence(telemetry(0, armed=False, ladder=SURFACE))
