"""Board and dive: pty, firmware process and bus, with a firmware of a few lines in place of the real one."""

import json
import os
import select
import signal
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

from agent.config import Fleet, Pose, Robot, Target, Twin
from hw.twin.boot import RESET_CAUSE
from hw.twin.devices import Board
from hw.twin.dive import Dive, run_in_lock_step

# Echoes its serial bytes with 1 added; arms at 0.1 s and then pushes up; 0x04 on the serial port ends it.
STAND_IN = """
import json, os, struct, sys
serial, bus, flash = int(sys.argv[1]), int(sys.argv[2]), json.load(open(sys.argv[3]))
TICK, ACT = struct.Struct("<Q4fHHBB"), struct.Struct("<Q8H4HHB")
assert len(flash["tare_pa"]) == 4
while True:
    record = os.read(bus, TICK.size)
    if not record:
        sys.exit()
    clock_us, *rest = TICK.unpack(record)
    try:
        heard = os.read(serial, 4096)
    except BlockingIOError:
        heard = b""
    if heard == b"die":
        sys.exit("the board is on fire")
    if heard:
        os.write(serial, bytes((byte + 1) % 256 for byte in heard))
    armed = clock_us >= 100_000
    up = 1580 if armed else 1500
    os.write(bus, ACT.pack(clock_us, up, up, up, up, 1500, 1500, 1500, 1500, 1700, 1400, 1500, 1500, 0, armed))
"""


@pytest.fixture
def firmware(tmp_path):
    path = tmp_path / "stand_in.py"
    path.write_text(textwrap.dedent(STAND_IN))
    return path


def fleet(names=("r1", "r2"), seed=4):
    robots = {
        name: Robot(
            listen=f"tcp/127.0.0.1:{17401 + i}",
            serial=f"twin:{name}",
            camera=f"twin:{name}",
            pose=Pose(x_m=0.4 + 0.6 * i, y_m=0.5, yaw_deg=30.0 * i),
            calibration="none.toml",
        )
        for i, name in enumerate(names)
    }
    return Fleet(fleet="tank", target={"ball": Target(radius_m=0.07)}, robot=robots, twin=Twin(seed=seed))


@pytest.fixture
def plunge(tmp_path, firmware):
    """Make dives whose boards are closed at the end."""
    boards = []

    def make(names=("r1", "r2"), seed=4):
        dive = Dive(fleet(names, seed), names, start_ns=0)
        dive.boards = [Board(n, tmp_path, tare, firmware) for n, tare in zip(names, dive.tare_pa, strict=True)]
        for board in dive.boards:
            board.start()
        boards.extend(dive.boards)
        return dive

    yield make
    for board in boards:
        board.close()


def gone(pid):
    """Whether the process has ended and been reaped."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def catch_up(board):
    """Let a firmware answer all that it was asked."""
    end_s = time.monotonic() + 10
    while board.overdue and time.monotonic() < end_s:
        time.sleep(0.01)
        board.act(0.0)


def read_all(fd, count, limit_s=5.0):
    data, end_s = b"", time.monotonic() + limit_s
    while len(data) < count and time.monotonic() < end_s:
        if select.select([fd], [], [], 0.05)[0]:
            data += os.read(fd, count - len(data))
    return data


def test_every_byte_value_passes_the_port_both_ways(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 2)
    port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY)
    try:
        every = bytes(range(256))
        os.write(port, every)
        time.sleep(0.05)  # the kernel hands a pty's bytes over in the background
        run_in_lock_step(dive, 3)
        assert read_all(port, 256) == every[1:] + every[:1]
    finally:
        os.close(port)


def test_the_agent_may_leave_the_port_and_come_back(plunge):
    dive = plunge(("r1",))
    for word in (b"\x01", b"\x02"):
        port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY)
        os.write(port, word)
        time.sleep(0.05)
        run_in_lock_step(dive, 3)
        assert read_all(port, 1) == bytes([word[0] + 1])
        os.close(port)
        run_in_lock_step(dive, 3)
    assert dive.boards[0].alive


def test_the_crew_holds_a_robot_until_it_is_armed(plunge):
    dive = plunge()
    start = dive.states["position_m"].copy()
    run_in_lock_step(dive, 10)
    np.testing.assert_array_equal(dive.states["position_m"], start)
    run_in_lock_step(dive, 60)
    assert np.all(dive.states["held"] == 0)
    assert np.all(dive.states["position_m"][:, 2] > start[:, 2] + 0.01)


def test_servo_pulses_turn_the_gimbal(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 100)
    pan, tilt = dive.states["shaft_deg"][0, :2]
    assert pan == pytest.approx(200 * 0.09, abs=1.7)  # zero, scale and play
    assert tilt == pytest.approx(-100 * 0.09, abs=1.7)


def test_the_same_seed_gives_the_same_bytes(plunge):
    ends = []
    for seed in (4, 4, 5):
        dive = plunge(seed=seed)
        dive.push("r2", (0.0, 0.0, -8.0), (0.13, 0.13, 0.0), 0.3)
        run_in_lock_step(dive, 150)
        ends.append(dive.states.tobytes())
        for board in dive.boards:
            board.close()
    assert ends[0] == ends[1] != ends[2]


def test_a_firmware_that_dies_is_told_of_stops_its_thrusters_alone_and_is_started_again(plunge, capfd):
    dive = plunge()
    run_in_lock_step(dive, 40)
    first = dive.boards[0]._boot._process.pid
    port = os.open(dive.boards[0].port, os.O_RDWR | os.O_NOCTTY)
    os.write(port, b"die")
    time.sleep(0.05)
    run_in_lock_step(dive, 55)
    assert not dive.boards[0].alive
    assert np.abs(dive.states["thrust_n"][0]).max() < 0.02 * dive.states["thrust_n"][1, :4].min()
    assert gone(first)
    run_in_lock_step(dive, 100)  # a second after its last boot it is started again, behind the same port
    assert dive.boards[0].alive
    os.write(port, b"\x01")
    time.sleep(0.05)
    run_in_lock_step(dive, 3)
    assert read_all(port, 1) == b"\x02"
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
    pid = dive.boards[0]._boot._process.pid
    os.kill(pid, signal.SIGSTOP)
    for _ in range(45):
        dive.tick(0.0)
    assert np.all(dive.states["thrust_n"][0, :4] > 0.1)
    os.kill(pid, signal.SIGCONT)
    catch_up(dive.boards[0])
    run_in_lock_step(dive, 60)
    assert dive.boards[0]._boot._process.pid == pid


def test_the_watchdog_resets_a_firmware_half_a_second_after_its_last_answer(plunge, capfd):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 40)
    pid = dive.boards[0]._boot._process.pid
    assert f"{RESET_CAUSE}=1".encode() in Path(f"/proc/{pid}/environ").read_bytes().split(b"\0")
    dive.boards[0].act(10.0)  # it has answered the last tick before it hangs
    dive.hang_firmware("r1")
    run_in_lock_step(dive, 49)
    assert dive.boards[0]._boot._process.pid == pid
    assert np.all(dive.states["thrust_n"][0, :4] > 0.1)  # an ESC knows nothing of it
    run_in_lock_step(dive, 2)
    second = dive.boards[0]._boot._process.pid
    assert second != pid and gone(pid)
    assert f"{RESET_CAUSE}=3".encode() in Path(f"/proc/{second}/environ").read_bytes().split(b"\0")
    run_in_lock_step(dive, 1)
    assert np.all(dive._pulses_us[0, :4] == 1500)
    assert capfd.readouterr().err == "twin: the firmware of r1 hung; its watchdog has reset it\n"


def test_a_twin_that_catches_up_on_lost_time_resets_nobody(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 3)
    pid = dive.boards[0]._boot._process.pid
    for _ in range(200):  # two seconds at once, more than the firmware can follow
        dive.tick(0.0)
    catch_up(dive.boards[0])
    run_in_lock_step(dive, 3)
    assert dive.boards[0]._boot._process.pid == pid


def test_a_pulled_cable_hangs_up_and_the_firmware_runs_on(plunge):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 20)
    board = dive.boards[0]
    pid = board._boot._process.pid
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
    os.write(port, b"\x01")
    time.sleep(0.05)
    run_in_lock_step(dive, 3)
    assert read_all(port, 1) == b"\x02"
    os.close(port)
    assert board._boot._process.pid == pid
    assert dive.states["thrust_n"][0, 0] > 0.1


def test_a_power_cut_takes_port_and_pulses_and_boots_anew(plunge, tmp_path):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 40)
    board = dive.boards[0]
    pid = board._boot._process.pid
    flash = tmp_path / "r1.flash.json"
    flash.write_text(json.dumps(json.loads(flash.read_text()) | {"law": "pid"}))
    dive.cut_power("r1", 0.3)
    assert gone(pid) and not os.path.lexists(board.port)
    run_in_lock_step(dive, 1)
    assert np.all(dive._pulses_us == 0)
    run_in_lock_step(dive, 25)
    assert not board.alive and not os.path.lexists(board.port)
    run_in_lock_step(dive, 10)
    assert board.driving and os.path.lexists(board.port)
    assert json.loads(flash.read_text())["law"] == "pid"


def test_lock_step_names_who_is_silent(plunge, monkeypatch):
    dive = plunge(("r1",))
    run_in_lock_step(dive, 3)
    os.kill(dive.boards[0]._boot._process.pid, signal.SIGSTOP)
    monkeypatch.setattr("hw.twin.dive.LOCK_STEP_S", 0.2)
    with pytest.raises(TimeoutError, match="firmware of r1"):
        run_in_lock_step(dive, 3)


def test_close_ends_even_a_firmware_that_hangs(plunge):
    dive = plunge(("r1",))
    board = dive.boards[0]
    run_in_lock_step(dive, 3)
    pid = board._boot._process.pid
    os.kill(pid, signal.SIGSTOP)
    board.close()
    assert gone(pid)
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
