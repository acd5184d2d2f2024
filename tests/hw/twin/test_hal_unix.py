"""The firmware's hardware on a computer: what it counts in a cycle, and what it says of ticks that are lost."""

import os
import socket
import struct
import sys

import pytest

from hw.firmware import bus
from tests.hw.desk import FIRMWARE

PRESSURE_PA = (101_325.0, 104_000.25, -1.0, 1e9)
# ns: armed, disarmed, a frame, a byte, a byte heard, a collection, a look at the heap
TIMES = "4000000 3000000 100000 20000 30000 2000000 1500000"


@pytest.fixture
def hal(monkeypatch, tmp_path):
    """A board, our end of its bus, our end of its tether."""
    monkeypatch.setenv(bus.TIMES, TIMES)
    monkeypatch.syspath_prepend(str(FIRMWARE))
    import hal_unix

    (ours, its), (uart, its_uart) = (socket.socketpair() for _ in range(2))
    its_uart.setblocking(False)
    made = hal_unix.Hal(its_uart.detach(), its.detach(), str(tmp_path / "flash.json"))
    yield made, ours, uart
    made._bus.close()
    made._serial.close()
    ours.close()
    uart.close()
    for name in ("hal_unix", "bus", "wire", "frames"):
        sys.modules.pop(name, None)


def tick(ours, clock_us, waited_us=0, percent=100):
    ours.sendall(bus.tick(clock_us, PRESSURE_PA, 14_800, 150, False, 15, waited_us, percent))


def answer(ours):
    """frame_us, pins_us, busy_us"""
    return struct.unpack(bus.ACT, ours.recv(bus.ACT_SIZE, socket.MSG_WAITALL))[-3:]


def test_each_thing_takes_its_time_and_pins_are_written_in_between(hal):
    board, ours, uart = hal
    tick(ours, 10_000)
    assert board.wait_tick() and board.cycle_us() == 0
    uart.sendall(bytes(50))
    assert board.read_into(bytearray(256)) == 50
    assert board.cycle_us() == 50 * 30
    board.armed = 1
    board.end_cycle()
    assert board.cycle_us() == 1500 + 4000
    board.write(bytes(78))
    board.collect()
    board.heap_free()
    busy_us = 5500 + 100 + 78 * 20 + 2000 + 1500
    assert board.cycle_us() == busy_us
    tick(ours, 20_000)
    assert board.wait_tick() and board.cycle_us() == 0
    assert answer(ours) == (5000, 5500, busy_us)
    board.armed = 0
    board.begin_pulses(2500)
    board.end_cycle()
    tick(ours, 30_000)
    board.wait_tick()
    assert answer(ours) == (2500, 3000, 3000)


def test_nothing_takes_time_where_nobody_says_what_it_takes(hal, monkeypatch):
    import hal_unix

    board, _, _ = hal
    monkeypatch.delenv(bus.TIMES)
    other = hal_unix.Hal(os.dup(board._serial.fileno()), os.dup(board._bus.fileno()), "none")
    other.end_cycle()
    other.collect()
    assert other.cycle_us() == 0
    other._bus.close()
    other._serial.close()


def test_ticks_that_are_lost_are_counted_and_a_wait_is_part_of_the_cycle(hal):
    board, ours, _ = hal
    seen = []
    for clock_us, waited_us in ((50_000, 0), (60_000, 0), (73_333, 3333), (86_666, 6666), (110_000, 0), (120_000, 0)):
        tick(ours, clock_us, waited_us)
        board.wait_tick()
        seen.append((board.now_us(), board.ticks, board.dt_us, board.late, board.cycle_us()))
    assert seen == [
        (50_000, 1, 10_000, 0, 0),
        (60_000, 1, 10_000, 0, 0),
        (70_000, 1, 10_000, 0, 3333),
        (80_000, 1, 10_000, 0, 6666),
        (110_000, 3, 30_000, 2, 0),
        (120_000, 1, 10_000, 2, 0),
    ]
    board.reboot()
    assert board.late == 0


def test_a_slower_board_takes_longer_for_everything(hal):
    board, ours, _ = hal
    tick(ours, 10_000, percent=250)
    board.wait_tick()
    board.end_cycle()
    board.write(bytes(10))
    assert board.cycle_us() == 2.5 * (3000 + 100 + 200)


def test_pressures_are_whole_millipascals_within_what_a_word_holds(hal):
    board, ours, _ = hal
    tick(ours, 10_000)
    board.wait_tick()
    assert board.pressure_mPa == [101_325_000, 104_000_250, 0, 0xFFFFFFFF]
    assert (board.battery_mv, board.current_10ma, board.leak, board.answered) == (14_800, 150, 0, 15)
