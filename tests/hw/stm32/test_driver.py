"""The host driver against the real firmware through a pty, and the conversation without any port."""

from __future__ import annotations

import os
import sys
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

import pytest

from agent.config import ConfigError
from agent.messages import SetPoint, Telemetry
from hw.firmware import failsafe, parameters, wire
from hw.stm32 import Stm32, open_port_path
from hw.stm32_arming import CURABLE
from hw.stm32_fields import event_line
from hw.stm32_talk import Talk

HOVER = SetPoint(depth_m=0.3, servos_us=(1400, 1600, 1500, 1500), light=0.5)


@pytest.fixture
def desk(put_on_desk):
    return put_on_desk(sys.executable)


def drive(desk, driver: Stm32, done: Callable[[], bool], ticks: int = 1200, send: bool = True) -> list[Telemetry]:
    """Turn the board's clock until `done`; what the driver heard meanwhile. Wall time only lets threads run."""
    telemetry = []
    for i in range(ticks):
        if send and i % 5 == 0:
            driver.send(HOVER, time.monotonic_ns())
        desk.tick()
        got, said = driver.drain()
        telemetry += got
        desk.said = getattr(desk, "said", []) + [line.text for line in said]
        if done():
            return telemetry
        time.sleep(0.001)
    raise AssertionError(f"not within {ticks} ticks; said {desk.said}")


class Port:
    """A path that can vanish and come back, as a cable does."""

    def __init__(self, desk, directory: Path) -> None:
        self.path = directory / "r1.serial"
        self.target = os.ttyname(desk.slave)
        self.plug()

    def plug(self) -> None:
        self.path.symlink_to(self.target)


@pytest.fixture
def port(desk, tmp_path):
    desk.listen = lambda: None  # the driver reads the tether, not the desk
    return Port(desk, tmp_path)


@pytest.fixture
def driver(port):
    with Stm32(str(port.path), time.monotonic_ns) as driver:
        yield driver


def armed(driver: Stm32) -> Callable[[], bool]:
    return lambda: driver._talk.armed


def test_arms_after_waiting_for_the_escs(desk, driver):
    driver.arm()
    telemetry = drive(desk, driver, armed(driver))
    assert any(text.startswith("arming waits") and "ESC" in text for text in desk.said)
    telemetry += drive(desk, driver, lambda: bool(desk.tick()[-1]))
    newest = telemetry[-1]
    assert newest.depth_m == pytest.approx(0.3, abs=0.001)
    assert newest.sensor_depth_m == pytest.approx((0.3,) * 4, abs=0.001)
    assert newest.servos_us == HOVER.servos_us
    assert newest.battery_v == pytest.approx(15.0)
    assert newest.flags & wire.FLAG_HELLO and newest.ladder == failsafe.OK
    counters = driver.counters
    assert counters.rx_ok > 100 and counters.rx_bad == counters.lost == counters.reconnects == 0
    assert counters.latency_ns is not None and counters.latency_ns > 0


def test_close_turns_the_motors_off_first(desk, port):
    with pytest.raises(KeyboardInterrupt), Stm32(str(port.path), time.monotonic_ns) as driver:
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


def test_restarted_board_is_not_armed_again(desk, driver):
    driver.arm()
    drive(desk, driver, armed(driver))
    desk.power_off()
    desk.power_on()
    drive(desk, driver, lambda: "the board has restarted; arm again" in desk.said)
    assert not driver.wants_armed
    with pytest.raises(AssertionError):
        drive(desk, driver, armed(driver), ticks=500)


def test_port_that_comes_late_and_is_another_one_later(desk, tmp_path):
    desk.listen = lambda: None
    path = tmp_path / "r1.serial"
    with Stm32(str(path), time.monotonic_ns) as driver:
        driver.send(HOVER, 1)
        driver.arm()
        time.sleep(0.15)
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
    with Stm32(str(port.path), time.monotonic_ns) as driver:
        driver.arm()
        drive(desk, driver, lambda: not driver.wants_armed)
        assert any("no tare in air" in text for text in desk.said)


def test_send_never_blocks_on_a_board_that_takes_nothing(tmp_path):
    master, slave = os.openpty()
    try:
        with Stm32(os.ttyname(slave), time.monotonic_ns) as driver:
            time.sleep(0.1)
            for i in range(20_000):
                driver.send(HOVER, i)
            assert len(driver._waiting) < 2048
    finally:
        os.close(master)
        os.close(slave)


def test_twin_url_and_device_path(tmp_path):
    assert open_port_path("twin:r2", tmp_path) == str(tmp_path / "r2.serial")
    assert open_port_path("/dev/ttyACM0", tmp_path) == "/dev/ttyACM0"
    with pytest.raises(ConfigError, match="twin:r1"):
        open_port_path("twin:", tmp_path)


# --- the conversation alone ---------------------------------------------------------------------------------------


class Board:
    """Says what a board would, byte by byte, with no board."""

    def __init__(self, talk: Talk, boot_id: int = 5) -> None:
        self.talk, self.boot_id, self.writer = talk, boot_id, wire.Writer()

    def greet(self, schema: int | None = None) -> None:
        schema = wire.schema_crc() if schema is None else schema
        count = len(parameters.TABLE)
        self.say(wire.HELLO_ACK, wire.PROTOCOL, schema, b"testtest", b"", self.boot_id, 1, 0, 0, count, 0)

    def telemetry(self, armed: int = 0, flags: int = wire.FLAG_HELLO) -> None:
        self.say(wire.TELEM, 1, armed, 0, flags, *[0] * 10, *[1500] * 12, 0, 15000, 0, 0, 0, 0, 0)

    def say(self, kind: int, *fields) -> None:
        self.say_at(1, kind, *fields)

    def say_at(self, now_ns: int, kind: int, *fields) -> None:
        self.talk.receive(bytes(self.writer.frame(kind, *fields)), now_ns)


def kinds(out: bytes) -> list[int]:
    got: list[int] = []
    wire.Framer(lambda kind, _seq, _payload: got.append(kind)).feed(out, len(out))
    return got


def test_commands_are_repeated_then_given_up_then_asked_anew():
    talk = Talk(1)
    Board(talk).greet()
    talk.arm()
    sent = [(ms, talk.due(ms * 1_000_000)) for ms in range(0, 2000, 10)]
    times = [ms for ms, out in sent if out]
    assert times[:4] == [0, 100, 200, 300]
    assert times[4] == 900
    assert len({out[1:-1] for ms, out in sent[:31] if out}) == 4, "numbered frames"


def test_nothing_is_believed_before_the_greeting():
    talk = Talk(1)
    board = Board(talk)
    board.telemetry()
    assert not talk.telemetry
    board.greet()
    board.telemetry()
    assert len(talk.telemetry) == 1


def test_another_schema_is_no_greeting():
    talk = Talk(1)
    board = Board(talk)
    board.greet(schema=1)
    board.telemetry()
    assert not talk.telemetry
    assert talk.said[-1].level == "error" and "flash" in talk.said[-1].text
    talk.arm()
    assert wire.ARM not in kinds(talk.due(10**9))


def test_lost_frames_and_late_readers_are_counted():
    talk = Talk(1)
    board = Board(talk)
    board.greet()
    board.writer.seq += 3
    for _ in range(300):
        board.telemetry()
    assert talk.counters.lost == 3
    assert talk.counters.dropped == 300 - len(talk.telemetry) > 0


def test_set_point_is_clipped_not_wrapped():
    talk = Talk(1)
    frame = talk.set_point(
        SetPoint(depth_m=99.0, force_n=(-99.0, 0.0), servos_us=(-5, 70000, 1500, 1500), light=7.0), 0
    )
    got = []
    wire.Framer(lambda kind, _seq, payload: got.append(wire.unpack(kind, payload))).feed(frame, len(frame))
    assert got[0][0] == 32767 and got[0][3] == -32768
    assert got[0][6:11] == (0, 65535, 1500, 1500, 1000)


def test_a_failsafe_that_is_over_is_said_to_be():
    assert event_line(wire.EV_LADDER, 0, 1, 1, 0).text.startswith("board: failsafe level 0 -> 1: ")
    assert event_line(wire.EV_LADDER, 1, 0, 0, 0) == ("info", "board: failsafe over, it was level 1")


def test_curable_reasons_exist():
    assert set(wire.ARM_CHECKS) >= CURABLE
