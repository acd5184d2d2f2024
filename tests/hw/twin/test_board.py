"""A board between its port and its power: bytes, cable, flash, and what is left when it is closed."""

import json
import math
import os
import signal
import struct
import sys
from pathlib import Path

import msgspec
import numpy as np
import pytest

from hw.firmware import bus, wire
from hw.twin.board import NO_TIME, RESET_CAUSE, Board, Boot, CycleTimes, read_table
from hw.twin.dive import run_in_lock_step
from hw.twin.physics.body import euler_rad
from hw.twin.physics.tank import STEP_S
from hw.twin.scene import SlowBoard
from tests.hw.firmware.diving_robot import HOVER, diving_robot
from tests.hw.twin.stand_ins import answer, catch_up, gone, pid, tell
from tests.places import ROOT
from tests.studies.board import imposed


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


# --- cycle times ---
# The board's time in the twin: ticks lost, pulses late, telemetry at the end of a cycle; and the table itself.

SET_POINT, TELEM, STATUS = (wire.SIZE[kind] + wire.OVERHEAD + 2 for kind in (wire.SETPOINT, wire.TELEM, wire.STATUS))
OVERRUN_US = 13_333


@pytest.fixture
def begun(monkeypatch):
    """(clock, waited) of each cycle that a firmware was given."""
    cycles = []
    plain = Boot.tick

    def tick(boot, clock_us, record):
        cycles.append(struct.unpack(bus.TICK, record)[:2])
        plain(boot, clock_us, record)

    monkeypatch.setattr(Boot, "tick", tick)
    return cycles


def test_a_board_that_keeps_its_cycle_is_given_each_tick(plunge, begun):
    run_in_lock_step(plunge(("r1",), takes_us=[5000, 9999]), 100)
    assert begun == [(10_000 * k, 0) for k in range(1, 101)]


def test_a_board_that_takes_13_ms_loses_every_fourth_tick_and_begins_at_once_when_it_is_free(plunge, begun):
    dive = plunge(("r1",), takes_us=[5000, OVERRUN_US])
    run_in_lock_step(dive, 101)
    clocks, waits = np.array(begun).T
    assert len(clocks) == 76
    assert set(np.diff(clocks)) == {OVERRUN_US}
    assert waits[:4].tolist() == [0, 3333, 6666, 9999]
    assert np.all((clocks - waits) % bus.TICK_US == 0)


def thrust_after(dive, ticks):
    """Of the first thruster, so long after the answer that arms and pushes up."""
    run_in_lock_step(dive, 10)  # the tick at 0.1 s is sent, its answer is still to come
    assert dive.states["thrust_n"][0, 0] == 0
    run_in_lock_step(dive, ticks)
    return dive.states["thrust_n"][0, 0], float(dive.bodies["thrust_lag_s"][0, 0])


@pytest.mark.parametrize(("pins_us", "shown_us"), [(0, 0), (1, 5000), (5000, 5000), (5001, 10_000), (12_000, 15_000)])
def test_pulses_change_with_the_next_frame_after_they_were_written(plunge, pins_us, shown_us):
    full_n, lag_s = thrust_after(plunge(("r1",), takes_us=[0, 0]), 300)
    thrust_n, _ = thrust_after(plunge(("r1",), takes_us=[pins_us, 0]), 2)
    assert thrust_n == pytest.approx(full_n * (1 - math.exp(-(0.02 - shown_us * 1e-6) / lag_s)), rel=0.01)


def test_what_a_board_says_is_there_when_its_cycle_is_over(plunge, monkeypatch):
    dive = plunge(("r1",), takes_us=[5000, 25_000])
    said = []
    monkeypatch.setattr(dive.boards[0]._cable, "send", lambda data: said.append((dive.ticks, data)))
    run_in_lock_step(dive, 1)
    port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tell(dive.boards[0], port, b"\x01")
        run_in_lock_step(dive, 10)
    finally:
        os.close(port)
    # The first cycle begins at tick 1 and ends at 35 ms; the second hears the byte, and is over at 60 ms.
    assert said == [(5, b"\x02")]


def test_the_water_moves_as_far_in_short_steps(plunge):
    """Splitting a tick where pulses change is no other physics: half steps differ by less than the steps themselves."""
    ends = []
    for pins_us in (4999, 5001):
        dive = plunge(("r1",), takes_us=[0, 0])
        run_in_lock_step(dive, 30)
        before_us = dive._advance(0, pins_us)
        dive._advance(before_us, 10_000)
        ends.append(dive.states["position_m"][0].copy())
    np.testing.assert_allclose(ends[0], ends[1], atol=STEP_S * 1e-3)


# --- the table ----------------------------------------------------------------------------------------------------


def test_the_table_tells_of_a_board_that_keeps_its_cycle():
    times = read_table().times
    armed_us = times.armed_us + SET_POINT * times.heard_byte_us
    telemetry_us = times.sent_frame_us + TELEM * times.sent_byte_us
    assert telemetry_us > 10 * TELEM  # at 1 Mbaud it takes that long on the wire alone
    assert 0 < times.disarmed_us < times.armed_us
    status_us = times.sent_frame_us + STATUS * times.sent_byte_us
    for also_us in (telemetry_us, status_us, times.collect_us, times.heap_free_us):
        assert armed_us + also_us < bus.TICK_US


def test_the_table_is_of_this_firmware():
    if hint := imposed.hint(ROOT / "hw" / "firmware"):
        pytest.skip(hint)


def test_a_record_is_whole_nanoseconds_in_the_order_of_the_hal():
    times = CycleTimes(
        armed_us=1.5, disarmed_us=2, sent_frame_us=3, sent_byte_us=4.0004, heard_byte_us=5, collect_us=6, heap_free_us=7
    )
    assert times.record() == "1500 2000 3000 4000 5000 6000 7000"
    assert NO_TIME.record() == "0 0 0 0 0 0 0"


# --- watchdog ---
# A firmware that dies or hangs: what its robot does meanwhile, when it is reset, and who is told.


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


# --- slow board ---
# A robot whose board does not keep its cycle: who arms it, and how it hovers.

CYCLE_US, SLOW_BOARD_OVERRUN_US = 5000.0, 13_333.0  # every cycle, whatever there is to do


def taking(cycle_us):
    return msgspec.structs.replace(NO_TIME, armed_us=cycle_us, disarmed_us=cycle_us)


def test_a_board_that_takes_13_ms_is_not_armed(tmp_path):
    with diving_robot(tmp_path, times=taking(SLOW_BOARD_OVERRUN_US)) as robot:
        robot.protocol.arm()
        robot.run(5.0)
        assert robot.heard("control cycle too slow")
        assert not robot.armed
        assert max(robot.dive._pulses_us[0]) == 1500


def test_the_board_that_ships_is_armed_and_hovers(tmp_path):
    with diving_robot(tmp_path) as robot:
        robot.arm()
        assert not robot.heard("slow")


def hovering_deg(robot, seconds):
    """Root mean square of the tilt."""
    tilts = []
    for _ in range(round(100 * seconds)):
        robot.run(0.01)
        tilts.append(robot.tilt_deg)
    return float(np.sqrt(np.mean(np.square(tilts))))


@pytest.mark.slow
def test_a_robot_rolls_where_its_board_loses_every_fourth_tick(tmp_path):
    fault = SlowBoard(at_s=14.0, robot="r1", by=SLOW_BOARD_OVERRUN_US / CYCLE_US)
    with diving_robot(tmp_path, [fault], taking(CYCLE_US)) as robot:
        robot.arm()
        before_deg = hovering_deg(robot, 3.0)
        robot.until(lambda: robot.dive.ticks >= 1400, 10.0)
        first = len(robot.telemetry)
        robot.run(1.0)
        after_deg = hovering_deg(robot, 3.0)
        assert robot.armed
        assert len(robot.telemetry) - first == pytest.approx(0.75 * 50 * 4, abs=3)
    assert before_deg < 0.2
    assert after_deg > 1.1 * before_deg, "nudges of the thrusters make most of either"


def sway_deg(robot, seconds=4.0):
    """Amplitude of the yaw that comes and goes once a second."""
    yaws = []
    for _ in range(round(100 * seconds)):
        robot.run(0.01)
        yaws.append(euler_rad(robot.dive.states["quaternion"][0])[2])
    t = np.arange(len(yaws)) / 100.0
    parts = [t**0, t, t**2, t**3, np.cos(2.0 * np.pi * t), np.sin(2.0 * np.pi * t)]
    return float(np.degrees(np.hypot(*np.linalg.lstsq(np.stack(parts, 1), np.unwrap(yaws), rcond=None)[0][4:])))


def test_nudges_do_not_sway_a_robot_whose_flat_thrusters_are_at_work(tmp_path):
    with diving_robot(tmp_path, moored=False) as robot:
        robot.arm()
        at_rest_deg = sway_deg(robot)
        robot.asks = msgspec.structs.replace(HOVER, force_n=(0.1, 0.0))
        robot.run(1.0)
        assert sway_deg(robot) < 0.4 * at_rest_deg
    assert at_rest_deg > 0.15
