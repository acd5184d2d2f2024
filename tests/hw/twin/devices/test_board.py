"""A board between its port and its power: bytes, cable, flash, and what is left when it is closed."""

import json
import os
import signal
import sys

import numpy as np
import pytest

from hw.twin.board import Board
from hw.twin.dive import run_in_lock_step
from tests.hw.twin.stand_ins import answer, gone, pid


def test_every_byte_value_passes_the_port_both_ways(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 2)
    port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY)
    try:
        every = bytes(range(256))
        assert answer(dive, port, every) == every[1:] + every[:1]
    finally:
        os.close(port)


def test_the_agent_may_leave_the_port_and_come_back(plunge):
    dive = plunge(("r1",))
    for word in (b"\x01", b"\x02"):
        port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY)
        assert answer(dive, port, word) == bytes([word[0] + 1])
        os.close(port)
        run_in_lock_step(dive, 3)
    assert dive.boards[0].alive


def test_a_pulled_cable_hangs_up_and_the_firmware_runs_on(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 20)
    board = dive.boards[0]
    first = pid(board)
    port = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
    dive.unplug("r1", 0.5)
    with pytest.raises(OSError, match="Input/output"):
        os.write(port, b"\x01")
    assert os.read(port, 1) == b""
    os.close(port)
    assert not os.path.lexists(board.port)
    run_in_lock_step(dive, 49)
    assert not os.path.lexists(board.port)
    run_in_lock_step(dive, 2)
    port = os.open(board.port, os.O_RDWR | os.O_NOCTTY)
    assert answer(dive, port, b"\x01") == b"\x02"
    os.close(port)
    assert pid(board) == first
    assert dive.states["thrust_n"][0, 0] > 0.1


def test_a_power_cut_takes_port_and_pulses_and_boots_anew(plunge, tmp_path):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 40)
    board = dive.boards[0]
    first = pid(board)
    flash = tmp_path / "r1.flash.json"
    flash.write_text(json.dumps(json.loads(flash.read_text()) | {"law": "pid"}))
    dive.cut_power("r1", 0.3)
    assert gone(first) and not os.path.lexists(board.port)
    run_in_lock_step(dive, 1)
    assert np.all(dive._pulses_us == 0)
    run_in_lock_step(dive, 25)
    assert not board.alive and not os.path.lexists(board.port)
    run_in_lock_step(dive, 10)
    assert board.driving and os.path.lexists(board.port)
    assert json.loads(flash.read_text())["law"] == "pid"


def test_close_ends_even_a_firmware_that_hangs(plunge):
    dive = plunge(("r1",))
    board = dive.boards[0]
    run_in_lock_step(dive, 3)
    first = pid(board)
    os.kill(first, signal.SIGSTOP)
    board.close()
    assert gone(first)
    assert not os.path.lexists(board.port)


def test_flash_holds_the_tare_of_each_sensor(plunge, tmp_path):
    dive = plunge(("r1",))
    flash = json.loads((tmp_path / "r1.flash.json").read_text())
    assert flash["tare_pa"] == pytest.approx(dive.tare_pa[0].tolist())


def test_an_unknown_interpreter_is_an_error_that_leaves_nothing(tmp_path, firmware):
    board = Board("r1", tmp_path, [0.0] * 4, firmware, interpreter=sys.executable + "-none")
    with pytest.raises(FileNotFoundError):
        board.start()
    board.close()
    assert not os.path.lexists(board.port)
