"""Orders through the driver: futures that always end, repeats, and parameters that a restart does not lose."""

from __future__ import annotations

import sys

import pytest

from agent.clock.clock import SystemClock
from agent.core.config import ConfigError
from hw.firmware import parameters, wire
from hw.stm32.driver import Stm32
from hw.stm32.protocol import NO_ANSWER, NO_BOARD
from tests.hw.firmware.nominal_plant import AIR_PA
from tests.hw.stm32.driven_desk import Port, drive
from tests.waiting import until


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
    assert listed.ok and listed.values == {row[0]: row[1] for row in parameters.TABLE}
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
