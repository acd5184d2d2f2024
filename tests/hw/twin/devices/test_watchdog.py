"""A firmware that dies or hangs: what its robot does meanwhile, when it is reset, and who is told."""

import os
import signal
from pathlib import Path

import numpy as np

from hw.twin.board import RESET_CAUSE, Board
from hw.twin.dive import run_in_lock_step
from tests.hw.twin.stand_ins import answer, catch_up, gone, pid, tell


def test_a_firmware_that_dies_is_told_of_stops_its_thrusters_alone_and_is_started_again(plunge, capfd):
    dive = plunge()
    run_in_lock_step(dive, 40)
    first = pid(dive.boards[0])
    port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY)
    tell(dive.boards[0], port, b"die")
    run_in_lock_step(dive, 55)
    assert not dive.boards[0].alive
    assert np.abs(dive.states["thrust_n"][0]).max() < 0.02 * dive.states["thrust_n"][1, :4].min()
    assert gone(first)
    run_in_lock_step(dive, 100)  # a second after its last boot it is started again, behind the same port
    assert dive.boards[0].alive
    assert answer(dive, port, b"\x01") == b"\x02"
    os.close(port)
    assert capfd.readouterr().err == "twin: the firmware of r1 has ended: the board is on fire\n"


def test_a_firmware_that_ends_at_every_start_is_told_of_once(tmp_path, capfd):
    firmware = tmp_path / "broken.py"
    firmware.write_text("raise SystemExit('no such law')")
    board = Board("r1", tmp_path, [0.0] * 4, firmware)
    board.start()
    try:
        for k in range(400):
            board.act(5.0)
            board.tick(k * 10_000, [0.0] * 4)
            assert not board.driving
    finally:
        board.close()
    assert capfd.readouterr().err == "twin: the firmware of r1 has ended: no such law\n"


def test_a_firmware_that_hangs_for_less_than_the_watchdog_waits_goes_on(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 40)
    first = pid(dive.boards[0])
    os.kill(first, signal.SIGSTOP)
    for _ in range(45):
        dive.tick(0.0)
    assert np.all(dive.states["thrust_n"][0, :4] > 0.1)
    os.kill(first, signal.SIGCONT)
    catch_up(dive.boards[0])
    run_in_lock_step(dive, 60)
    assert pid(dive.boards[0]) == first


def test_the_watchdog_resets_a_firmware_half_a_second_after_its_last_answer(plunge, capfd):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 40)
    first = pid(dive.boards[0])
    assert f"{RESET_CAUSE}=1".encode() in Path(f"/proc/{first}/environ").read_bytes().split(b"\0")
    dive.boards[0].act(10.0)  # it has answered the last tick before it hangs
    dive.hang_firmware("r1")
    run_in_lock_step(dive, 49)
    assert pid(dive.boards[0]) == first
    assert np.all(dive.states["thrust_n"][0, :4] > 0.1)  # an ESC knows nothing of it
    run_in_lock_step(dive, 2)
    second = pid(dive.boards[0])
    assert second != first and gone(first)
    assert f"{RESET_CAUSE}=3".encode() in Path(f"/proc/{second}/environ").read_bytes().split(b"\0")
    run_in_lock_step(dive, 1)
    assert np.all(dive._pulses_us[0, :4] == 1500)
    assert capfd.readouterr().err == "twin: the firmware of r1 hung; its watchdog has reset it\n"


def test_a_twin_that_catches_up_on_lost_time_resets_nobody(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 3)
    first = pid(dive.boards[0])
    for _ in range(200):  # two seconds at once, more than the firmware can follow
        dive.tick(0.0)
    catch_up(dive.boards[0])
    run_in_lock_step(dive, 3)
    assert pid(dive.boards[0]) == first
