"""Orders through the driver: futures that always end, repeats, and parameters that a restart does not lose."""

from __future__ import annotations

import sys
import time

import pytest
from nominal_plant import AIR_PA
from test_stm32 import Board, Port, drive

from agent.config import ConfigError
from hw.firmware import parameters, wire
from hw.stm32 import Stm32
from hw.stm32_orders import NO_ANSWER, NO_BOARD, OVERTAKEN
from hw.stm32_talk import Talk

MS = 1_000_000


@pytest.fixture
def desk(put_on_desk):
    desk = put_on_desk(sys.executable)
    desk.listen = lambda: None  # the driver reads the tether
    return desk


@pytest.fixture
def driver(desk, tmp_path):
    with Stm32(str(Port(desk, tmp_path).path), time.monotonic_ns) as driver:
        drive(desk, driver, lambda: driver.counters.rx_ok > 5)
        yield driver


def outcome(desk, driver, future):
    drive(desk, driver, future.done)
    return future.result(0)


def test_parameters(desk, driver):
    listed = outcome(desk, driver, driver.parameters())
    assert listed.ok and listed.values == {row[0]: row[2] for row in parameters.TABLE}
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
        Stm32("/nowhere", time.monotonic_ns).set_parameter(name, value)


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
    drive(desk, driver, lambda: driver._talk._orders.idle)
    assert outcome(desk, driver, driver.parameter("net_weight_N")).values == {"net_weight_N": 1.5}


def test_a_pulled_plug_ends_what_was_asked(desk, driver):
    future = driver.tare()
    desk.power_off()
    deadline_s = time.monotonic() + 3.0
    while not future.done() and time.monotonic() < deadline_s:
        time.sleep(0.01)
        driver.drain()
    assert future.result(0).result in (NO_ANSWER, NO_BOARD)


def test_a_tap_sees_all_bytes_of_both_directions(desk, tmp_path):
    seen = {True: b"", False: b""}

    def tap(from_board: bool, data: bytes) -> None:
        seen[from_board] += data

    with Stm32(str(Port(desk, tmp_path).path), time.monotonic_ns, tap=tap) as driver:
        drive(desk, driver, lambda: driver.counters.rx_ok > 20)
        frames = driver.counters.rx_ok
    for from_board, kind in ((True, wire.TELEM), (False, wire.SETPOINT)):
        kinds: list[int] = []
        framer = wire.Framer(lambda kind, _seq, _payload, kinds=kinds: kinds.append(kind))
        framer.feed(seen[from_board], len(seen[from_board]))
        assert kind in kinds and framer.rx_bad == 0
        assert not from_board or framer.rx_ok >= frames


# --- the conversation alone ---------------------------------------------------------------------------------------


def test_without_a_board_an_order_ends_at_once():
    assert Talk(1).ask(wire.PARAM_LIST).result(0).result == NO_BOARD


def test_an_order_is_repeated_three_times():
    talk = Talk(1)
    Board(talk).greet()
    future = talk.ask(wire.PARAM_SAVE)
    times = [ms for ms in range(0, 1000, 10) if talk.due(ms * MS)]
    assert times == [0, 100, 200, 300]
    assert future.result(0).result == NO_ANSWER
    assert talk.is_answered()


def test_a_board_at_work_is_asked_twice_a_second():
    talk = Talk(1)
    board = Board(talk)
    board.greet()
    future = talk.ask(wire.TARE, 0)
    times = []
    for ms in range(0, 3000, 10):
        if talk.due(ms * MS):
            times.append(ms)
            board.say_at(ms * MS + 1, wire.ACK, 1, wire.TARE, wire.OK if ms >= 2000 else wire.RUNNING, board.boot_id)
    assert times == [0, 510, 1020, 1530, 2040]
    assert future.result(0).ok


def test_a_stop_overtakes_and_ends_the_others():
    talk = Talk(1)
    Board(talk).greet()
    first, second = talk.ask(wire.TARE, 0), talk.ask(wire.PARAM_SAVE)
    talk.due(0)
    talk.stop(wire.ESTOP)
    assert first.result(0).result == second.result(0).result == OVERTAKEN
    assert talk.due(1) and not talk.is_answered()


def test_a_list_of_which_a_part_was_lost_is_asked_for_again():
    talk = Talk(1)
    board = Board(talk)
    board.greet()
    future = talk.ask(wire.PARAM_LIST)
    for ms, lost in ((0, {2, 3}), (300, {0, 7})):
        assert not talk.due((ms - 1) * MS) and talk.due(ms * MS)
        for i in set(range(len(parameters.TABLE))) - lost:
            board.say(wire.PARAM_VALUE, 1, board.boot_id, i, parameters.TABLE[i][5], 0, parameters.TABLE[i][2])
    assert len(future.result(0).values) == len(parameters.TABLE)


def test_a_reboot_whose_answer_was_lost_has_happened():
    talk = Talk(1)
    board = Board(talk)
    board.greet()
    future = talk.ask(wire.REBOOT, wire.REBOOT_MAGIC)
    talk.due(0)
    board.say(wire.ACK, 1, wire.REBOOT, wire.STALE_BOOT, board.boot_id + 1)
    assert future.result(0).ok


def test_a_cancelled_order_disturbs_nobody():
    talk = Talk(1)
    board = Board(talk)
    board.greet()
    future = talk.ask(wire.PARAM_SAVE)
    talk.due(0)
    assert future.cancel()
    board.say(wire.ACK, 1, wire.PARAM_SAVE, wire.OK, board.boot_id)
    assert talk.is_answered()
