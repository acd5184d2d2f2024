"""The conversation with the control module, without any port: who is believed, what is repeated, how orders end."""

from __future__ import annotations

import itertools
import math
import os
import sys
import threading
import time
from collections.abc import Iterator

import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agent.clock.clock import SystemClock
from agent.core.config import ConfigError, dump
from agent.core.step_io import SetPoint
from agent.ground.board import run as run_board
from agent.process.command import Failed
from hw.firmware import failsafe, parameters, wire
from hw.module import CURABLE, Arming
from hw.stm32.driver import Stm32
from hw.stm32.protocol import NO_ANSWER, NO_BOARD, OVERTAKEN, HostProtocol, event_line
from tests.hw.firmware.diving_robot import FLEET
from tests.hw.firmware.nominal_plant import AIR_PA
from tests.hw.stm32.driven_desk import Port, drive
from tests.hw.stm32.fake_board import FakeBoard, frames, kinds
from tests.waiting import until

MS = 1_000_000


def test_commands_are_repeated_then_given_up_then_asked_anew():
    protocol = HostProtocol(1)
    FakeBoard(protocol).greet()
    protocol.arm()
    sent = [(ms, protocol.due(ms * 1_000_000)) for ms in range(0, 2000, 10)]
    times = [ms for ms, out in sent if out]
    assert times[:4] == [0, 100, 200, 300]
    assert times[4] == 900
    assert len({out[1:-1] for ms, out in sent[:31] if out}) == 4, "numbered frames"


def test_nothing_is_believed_before_the_greeting():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.telemetry()
    assert not protocol.telemetry
    board.greet()
    board.telemetry()
    assert len(protocol.telemetry) == 1


def test_another_schema_is_no_greeting():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet(schema=1)
    board.telemetry()
    assert not protocol.telemetry
    assert protocol.lines[-1].level == "error" and "flash" in protocol.lines[-1].text
    protocol.arm()
    assert wire.ARM not in kinds(protocol.due(10**9))


@pytest.mark.parametrize(("rate_cdeg_s", "warnings"), [(wire.NO_RATE, 1), (0, 0)])
def test_arming_a_board_without_an_imu_says_so_once_a_boot(rate_cdeg_s, warnings):
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    for s in (1, 2):
        board.telemetry(rate=rate_cdeg_s)
        protocol.arm()
        ((_, (req_id, _)),) = frames(protocol.due(s * 1000 * MS))
        board.say(wire.ACK, req_id, wire.ARM, wire.OK, board.boot_id)
        board.telemetry(rate=rate_cdeg_s)
    assert sum(line.text.startswith("no IMU") for line in protocol.lines) == warnings


def test_another_board_at_this_port_is_told_nothing_until_the_right_one_is_back():
    """As where two robots' cables change places: each stays armed, and would swim by the other's orders."""
    protocol = HostProtocol(1)
    ours, other = FakeBoard(protocol, boot_id=5), FakeBoard(protocol, boot_id=6)
    ours.greet(uid=b"twelve bytes")
    protocol.arm()
    ours.telemetry(armed=1)
    assert protocol.set_point(SetPoint(depth_m=0.2), 0) and not protocol.faults
    protocol.hung_up()
    protocol.connected()
    assert not protocol.set_point(SetPoint(depth_m=0.2), 0), "whose board this is nobody knows yet"
    other.greet(uid=b"other twelve")
    other.telemetry(armed=1)
    protocol.stop(wire.ESTOP)
    assert kinds(protocol.due(10**9)) == [wire.HELLO] and not protocol.set_point(SetPoint(depth_m=0.2), 0)
    assert "another control module answers" in protocol.faults["tether"] == protocol.lines[-1].text
    assert b"other twelve".hex() in protocol.faults["tether"] and len(protocol.telemetry) == 1
    protocol.hung_up()
    protocol.connected()
    ours.greet(uid=b"twelve bytes")
    assert protocol.set_point(SetPoint(depth_m=0.2), 0) and not protocol.faults


def test_a_board_that_comes_after_a_silence_is_asked_who_it_is():
    """Two tethers that change places behind converters whose ports stay open; both boards were greeted before."""
    protocol = HostProtocol(1)
    ours, other = FakeBoard(protocol, boot_id=5), FakeBoard(protocol, boot_id=6)
    ours.greet(uid=b"twelve bytes")
    ours.telemetry(armed=1)
    other.telemetry(armed=1, now_ns=3000 * MS)
    assert len(protocol.telemetry) == 1 and not protocol.set_point(SetPoint(depth_m=0.2), 0)
    protocol.stop(wire.ESTOP)
    assert kinds(protocol.due(3010 * MS)) == [wire.HELLO], "a stop is for our robot"
    other.greet(uid=b"other twelve")
    other.telemetry(armed=1)
    assert "tether" in protocol.faults and not protocol.set_point(SetPoint(depth_m=0.2), 0)
    assert kinds(protocol.due(9000 * MS)) == [wire.HELLO] and len(protocol.telemetry) == 1
    ours.greet(uid=b"twelve bytes")
    assert kinds(protocol.due(9010 * MS)) == [wire.ESTOP] and not protocol.faults


def test_a_stop_waits_no_longer_than_a_second_for_a_greeting():
    protocol = HostProtocol(1)
    FakeBoard(protocol).greet()
    protocol.hung_up()
    protocol.connected()
    protocol.stop(wire.ESTOP)
    sent = {ms: kinds(protocol.due(ms * MS)) for ms in range(0, 1100, 100)}
    assert not any(wire.ESTOP in each for ms, each in sent.items() if ms < 1000) and wire.ESTOP in sent[1000]


def test_what_flags_say_and_why_it_surfaces_are_faults_as_long_as_they_last():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    count = itertools.count()

    def level(before: int, after: int, why: str) -> dict[str, str]:
        board.say(wire.EVENT, 0, wire.EV_LADDER, before, after, 2, wire.REASONS.index(why), next(count))
        board.telemetry(flags=wire.FLAG_HELLO | (wire.FLAG_LEAK if after else 0), ladder=after)
        return protocol.faults

    board.telemetry(flags=wire.FLAG_HELLO | wire.FLAG_KILLED)
    assert list(protocol.faults) == ["kill switch"]
    board.telemetry()
    assert not protocol.faults
    assert level(0, 2, "leak")["failsafe cause"] == "leak" and "leak" in protocol.faults
    assert level(2, 3, "surfaced")["failsafe cause"] == "leak, then surfaced"
    board.telemetry()  # armed again, which no event of the ladder tells
    assert not protocol.faults
    assert level(0, 1, "host silent")["failsafe cause"] == "host silent"
    assert level(1, 2, "host silent")["failsafe cause"] == "host silent"
    board.telemetry()
    board.say(wire.EVENT, 0, wire.EV_DISARMED, 0, failsafe.LATCHED, 2, wire.REASONS.index("emergency stop"), 99)
    board.telemetry(ladder=failsafe.LATCHED)
    assert protocol.faults == {"failsafe cause": "emergency stop"}


@pytest.mark.parametrize(("lost", "broken", "said"), [(0, 0, ""), (12, 0, "12% are lost"), (0, 30, "to it 30%")])
def test_a_line_that_loses_frames_is_a_fault(lost: int, broken: int, said: str):
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    for second in range(1, 12):
        assert not protocol.faults, "too early to tell"
        for _ in range(99 - lost):
            board.telemetry()
        board.writer.seq += lost
        board.say(wire.STATUS, 0, 0, 0, 0, 0, (100 - broken) * second, broken * second, 0, 0, 0, 0)
        if second >= 10:
            break
    assert said in protocol.faults.get("tether", "") and bool(said) == bool(protocol.faults)


def test_lost_frames_and_late_readers_are_counted():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    board.writer.seq += 3
    for _ in range(300):
        board.telemetry()
    assert protocol.counters.lost == 3
    assert protocol.counters.dropped == 300 - len(protocol.telemetry) > 0


def test_set_point_is_clipped_not_wrapped():
    protocol = HostProtocol(1)
    FakeBoard(protocol).greet()
    frame = protocol.set_point(
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


# --- orders -------------------------------------------------------------------------------------------------------


def test_without_a_board_an_order_ends_at_once():
    assert HostProtocol(1).ask(wire.PARAM_LIST).result(0).result == NO_BOARD


def test_an_order_is_repeated_three_times():
    protocol = HostProtocol(1)
    FakeBoard(protocol).greet()
    future = protocol.ask(wire.PARAM_SAVE)
    times = [ms for ms in range(0, 1000, 10) if protocol.due(ms * MS)]
    assert times == [0, 100, 200, 300]
    assert future.result(0).result == NO_ANSWER
    assert protocol.is_answered()


def test_a_board_at_work_is_asked_twice_a_second():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    future = protocol.ask(wire.TARE, 0)
    times = []
    for ms in range(0, 3000, 10):
        if protocol.due(ms * MS):
            times.append(ms)
            board.say_at(ms * MS + 1, wire.ACK, 1, wire.TARE, wire.OK if ms >= 2000 else wire.RUNNING, board.boot_id)
    assert times == [0, 510, 1020, 1530, 2040]
    assert future.result(0).ok


def test_a_stop_overtakes_and_ends_the_others():
    protocol = HostProtocol(1)
    FakeBoard(protocol).greet()
    first, second = protocol.ask(wire.TARE, 0), protocol.ask(wire.PARAM_SAVE)
    protocol.due(0)
    protocol.stop(wire.ESTOP)
    assert first.result(0).result == second.result(0).result == OVERTAKEN
    assert protocol.due(1) and not protocol.is_answered()


def test_a_list_of_which_a_part_was_lost_is_asked_for_again():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    future = protocol.ask(wire.PARAM_LIST)
    for ms, lost in ((0, {2, 3}), (500, {0, 7})):
        assert not protocol.due((ms - 1) * MS) and protocol.due(ms * MS)
        for i in set(range(len(parameters.TABLE))) - lost:
            board.say(wire.PARAM_VALUE, 1, board.boot_id, i, parameters.TABLE[i][4], 0, parameters.TABLE[i][1])
    assert len(future.result(0).values) == len(parameters.TABLE)


def test_a_reboot_whose_answer_was_lost_has_happened():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    future = protocol.ask(wire.REBOOT, wire.REBOOT_MAGIC)
    protocol.due(0)
    board.say(wire.ACK, 1, wire.REBOOT, wire.STALE_BOOT, board.boot_id + 1)
    assert future.result(0).ok


def test_a_cancelled_order_disturbs_nobody():
    protocol = HostProtocol(1)
    board = FakeBoard(protocol)
    board.greet()
    future = protocol.ask(wire.PARAM_SAVE)
    protocol.due(0)
    assert future.cancel()
    board.say(wire.ACK, 1, wire.PARAM_SAVE, wire.OK, board.boot_id)
    assert protocol.is_answered()


# --- board reboot ---
# A latched board is rebooted by a person's order, one with its motors on is not.


@pytest.fixture
def started(put_on_desk, monkeypatch) -> Iterator:
    """started(reset_cause, flash) is a board whose time passes by itself."""
    stop, threads = threading.Event(), []

    def start(reset_cause: int = wire.POWER_ON, flash=None):
        monkeypatch.setenv("AUCAMP_RESET_CAUSE", str(reset_cause))
        desk = put_on_desk(sys.executable, flash)
        desk.listen = lambda: None  # the driver reads the tether, not the desk
        pins = []

        def run() -> None:
            while not stop.is_set():
                pins[:] = desk.tick()
                time.sleep(0.001)

        threads.append(threading.Thread(target=run))
        return desk, pins, threads[-1]

    yield start
    stop.set()
    for thread in threads:
        if thread.is_alive():
            thread.join()


def fleet_file(tmp_path, port: str):
    robot = replace(FLEET.robot["r1"], serial=port, camera="v4l2:/dev/video0")
    path = tmp_path / "fleet.toml"
    path.write_text(dump(replace(FLEET, robot={"r1": robot})))
    return path


def test_after_the_watchdog_the_board_is_rebooted_and_nothing_is_latched(started, tmp_path):
    desk, _, board_time = started(wire.BY_WATCHDOG)
    board_time.start()
    said: list[str] = []
    run_board("reboot", fleet_file(tmp_path, os.ttyname(desk.slave)), "r1", said.append)
    assert any("reset by watchdog: reboot by order" in line for line in said)
    assert said[-1].startswith("r1: rebooted; arm it")


def test_a_board_that_latches_again_says_why(started, tmp_path):
    desk, _, board_time = started(flash={"law": "pip"})
    board_time.start()
    with pytest.raises(Failed, match=r"latched again \(board: flash: law = pip"):
        run_board("reboot", fleet_file(tmp_path, os.ttyname(desk.slave)), "r1", lambda line: None)


def test_a_robot_with_its_motors_on_is_left_to_itself(started, tmp_path):
    desk, pins, board_time = started()
    del desk.listen
    desk.arm()
    desk.listen = lambda: None
    board_time.start()
    with pytest.raises(Failed, match="its motors are on"):
        run_board("reboot", fleet_file(tmp_path, os.ttyname(desk.slave)), "r1", lambda line: None)
    assert pins[-1] == wire.ARMED and min(pins[1:5]) > 1500, "and goes up"


def test_nobody_there_is_told(tmp_path):
    with pytest.raises(Failed, match=r"r1: no board answers \(.*No such file"):
        run_board("reboot", fleet_file(tmp_path, str(tmp_path / "nothing")), "r1", lambda line: None, limit_s=0.5)


def test_a_refusal_to_arm_names_the_way_out():
    arming = Arming()
    arming.want()
    line = arming.refused(1 << wire.ARM_CHECKS.index("fault latched"))
    assert line is not None and "aucamp board reboot" in line.text and failsafe.LATCHED == 4
    arming.want()
    line = arming.refused(1 << wire.ARM_CHECKS.index("leak"))
    assert line is not None and "put it right" in line.text


# --- orders ---
# Orders through the driver: futures that always end, repeats, and parameters that a restart does not lose.


@pytest.fixture
def desk(put_on_desk):
    desk = put_on_desk(sys.executable)
    desk.listen = lambda: None  # the driver reads the tether
    return desk


@pytest.fixture
def driver(desk, tmp_path):
    with Stm32(str(Port(desk, tmp_path).path), SystemClock()) as driver:
        drive(desk, driver, lambda: driver.counters.rx_ok > 5)
        yield driver


def outcome(desk, driver, future):
    drive(desk, driver, future.done)
    return future.result(0)


def test_parameters(desk, driver):
    listed = outcome(desk, driver, driver.parameters())
    assert listed.ok and listed.values == {row[0]: row[1] for row in parameters.TABLE} | {"wiring": failsafe.WIRING}
    assert driver.greeting.parameters_crc == parameters.crc([listed.values[name] for name in parameters.NAMES])
    assert outcome(desk, driver, driver.set_parameter("lag_s", 0.15)).values == {"lag_s": 0.15}
    assert outcome(desk, driver, driver.parameter("lag_s")).values == {"lag_s": 0.15}
    assert outcome(desk, driver, driver.save_parameters()).ok
    assert '"lag_s": 0.15' in desk.flash_path.read_text()


@pytest.mark.parametrize(
    ("name", "value", "advice"),
    [("lag", 0.1, "write one of: law"), ("lag_s", 9.0, "0.02 to 0.4 s"), ("law", 0.5, "whole")],
)
def test_what_cannot_be_set_is_told_at_once(name, value, advice):
    with pytest.raises(ConfigError, match=advice):
        Stm32("/nowhere", SystemClock()).set_parameter(name, value)


def test_tare_and_mode(desk, driver):
    desk.pressure_pa = [AIR_PA + 40.0] * 4
    assert outcome(desk, driver, driver.tare()).ok
    assert f'"tare_pa": [{AIR_PA + 40.0}' in desk.flash_path.read_text()
    assert outcome(desk, driver, driver.mode("bench", 3)).ok
    assert outcome(desk, driver, driver.mode("surface")).result == "refused"
    desk.pressure_pa[0] += 600.0
    assert outcome(desk, driver, driver.tare()).result == "refused"


def test_reboot_brings_back_what_was_set_and_not_saved(desk, driver):
    boot_id = driver.greeting.boot_id
    assert outcome(desk, driver, driver.set_parameter("net_weight_N", 1.5)).ok
    assert outcome(desk, driver, driver.reboot()).ok
    drive(desk, driver, lambda: driver.greeting.boot_id != boot_id)
    assert driver.greeting.reset_cause == wire.BY_ORDER
    drive(desk, driver, lambda: driver._protocol._orders.idle)
    assert outcome(desk, driver, driver.parameter("net_weight_N")).values == {"net_weight_N": 1.5}


def test_a_pulled_plug_ends_what_was_asked(desk, driver):
    future = driver.tare()
    desk.power_off()
    until(future.done, 3.0)
    assert future.result(0).result in (NO_ANSWER, NO_BOARD)


def test_a_tap_sees_all_bytes_of_both_directions(desk, tmp_path):
    seen = {True: b"", False: b""}

    def tap(from_board: bool, data: bytes) -> None:
        seen[from_board] += data

    with Stm32(str(Port(desk, tmp_path).path), SystemClock(), tap=tap) as driver:
        drive(desk, driver, lambda: driver.counters.rx_ok > 20)
        frames = driver.counters.rx_ok
    for from_board, kind in ((True, wire.TELEM), (False, wire.SETPOINT)):
        kinds: list[int] = []
        framer = wire.Framer(lambda kind, _seq, _payload, kinds=kinds: kinds.append(kind))
        framer.feed(seen[from_board], len(seen[from_board]))
        assert kind in kinds and framer.rx_bad == 0
        assert not from_board or framer.rx_ok >= frames


# --- versions ---
# Boards and hosts of two versions of the protocol: the older one is served as it always was.

HOST_BOOT = 9


def greetings(out):
    return [fields for kind, fields in frames(out) if kind == wire.HELLO]


@pytest.mark.parametrize("version", [1, 2])
def test_an_old_board_is_served_as_it_was(version) -> None:
    """Twenty parameters, and a list of them ends there."""
    protocol = HostProtocol(HOST_BOOT)
    board = FakeBoard(protocol, version=version)
    protocol.due(0)
    board.greet(version=1)
    said = greetings(protocol.due(10 * MS))
    assert said == ([] if version == 1 else [(2, 0x9345DAF7, HOST_BOOT)])
    board.greet()
    asked = protocol.ask(wire.PARAM_LIST)
    ((_, (req_id, _)),) = frames(protocol.due(20 * MS))
    for i in range(20):
        assert not asked.done()
        board.say(wire.PARAM_VALUE, req_id, board.boot_id, i, 0, 0, 1.0)
    assert asked.result(0).ok and list(asked.result(0).values) == parameters.NAMES[:20]


def test_an_old_board_hears_what_it_always_heard() -> None:
    protocol = HostProtocol(HOST_BOOT)
    board = FakeBoard(protocol, version=1)
    assert greetings(protocol.due(0)) == [(1, 0xA725AA30, HOST_BOOT)]
    board.greet()
    assert not any(protocol.due(ms * MS) for ms in range(10, 3000, 10)), "nothing more to be said"
    board.telemetry()
    assert protocol.telemetry[-1].rate_rad_s is UNSET
    assert [line.text for line in protocol.lines] == ["board testtest, boot 00000005"]


def test_a_new_board_is_greeted_in_what_it_offers_until_it_agrees() -> None:
    protocol = HostProtocol(HOST_BOOT)
    board = FakeBoard(protocol)
    protocol.due(0)
    board.greet(version=1)
    asked = [ms for ms in range(10, 1200, 10) if greetings(protocol.due(ms * MS)) == [(3, wire.SCHEMA_CRC[3], 9)]]
    assert asked == [10, 510, 1010]
    protocol.arm()
    board.greet()
    assert wire.ARM in [kind for kind, _ in frames(protocol.due(1200 * MS))]
    assert not greetings(protocol.due(3000 * MS))
    board.telemetry(rate=-4500)
    assert protocol.telemetry[-1].rate_rad_s == pytest.approx(math.radians(-45.0))
    board.telemetry()
    assert protocol.telemetry[-1].rate_rad_s is UNSET
    assert [line.text for line in protocol.lines] == ["board testtest, boot 00000005"], "one greeting for people"


def test_a_board_that_restarts_as_an_older_one_is_served_as_that() -> None:
    protocol = HostProtocol(HOST_BOOT)
    FakeBoard(protocol).greet()
    old = FakeBoard(protocol, boot_id=6, version=1)
    old.telemetry(flags=0)
    assert greetings(protocol.due(1000 * MS)) == [(1, wire.SCHEMA_CRC[1], HOST_BOOT)]
    old.greet()
    assert not protocol.due(3000 * MS)


@pytest.mark.parametrize(("version", "kind"), [(1, wire.TELEM_1), (2, wire.TELEM), (3, wire.TELEM)])
def test_the_firmware_speaks_all(put_on_desk, version, kind) -> None:
    desk = put_on_desk(sys.executable)
    desk.yaw_rate = 4321
    desk.say(wire.HELLO, version, wire.SCHEMA_CRC[version], 77)
    said = desk.until(lambda: desk.heard(wire.HELLO_ACK))[0]
    assert (
        said[:2] == (version, wire.SCHEMA_CRC[version])
        and said[-1] & wire.CAN_VERSION_2
        and said[-1] & wire.CAN_VERSION_3
    )
    assert said[-2] == (22 if version == 3 else 20), "an old host wants as many parameters as it knows"
    desk.forget()
    desk.tick(6)
    told = desk.heard(kind)
    assert len(told) >= 2 and len(told) == len(desk.heard(wire.TELEM) + desk.heard(wire.TELEM_1))
    assert told[-1][3] & wire.FLAG_HELLO
    assert told[-1][-1] == 4321 if version > 1 else len(told[-1]) == 33


def test_the_firmware_refuses_what_it_does_not_know(put_on_desk) -> None:
    desk = put_on_desk(sys.executable)
    desk.say(wire.HELLO, 4, 12345, 77)
    assert desk.until(lambda: desk.heard(wire.HELLO_ACK))[0][:2] == (wire.PROTOCOL, wire.schema_crc())
    desk.forget()
    desk.tick(6)
    assert not any(fields[3] & wire.FLAG_HELLO for fields in desk.heard(wire.TELEM_1))
