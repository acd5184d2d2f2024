"""A latched board is rebooted by a person's order, one with its motors on is not."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections.abc import Iterator

import pytest
from msgspec.structs import replace

from agent.core.config import dump
from agent.ground.board_reboot import reboot
from agent.process.command import Failed
from hw.firmware import failsafe, wire
from hw.stm32.protocol import Arming
from tests.hw.firmware.diving_robot import FLEET


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
    reboot(fleet_file(tmp_path, os.ttyname(desk.slave)), "r1", said.append)
    assert any("reset by watchdog: reboot by order" in line for line in said)
    assert said[-1].startswith("r1: rebooted; arm it")


def test_a_board_that_latches_again_says_why(started, tmp_path):
    desk, _, board_time = started(flash={"law": "pip"})
    board_time.start()
    with pytest.raises(Failed, match=r"latched again \(board: flash: law = pip"):
        reboot(fleet_file(tmp_path, os.ttyname(desk.slave)), "r1", lambda line: None)


def test_a_robot_with_its_motors_on_is_left_to_itself(started, tmp_path):
    desk, pins, board_time = started()
    del desk.listen
    desk.arm()
    desk.listen = lambda: None
    board_time.start()
    with pytest.raises(Failed, match="its motors are on"):
        reboot(fleet_file(tmp_path, os.ttyname(desk.slave)), "r1", lambda line: None)
    assert pins[-1] == wire.ARMED and min(pins[1:5]) > 1500, "and goes up"


def test_nobody_there_is_told(tmp_path):
    with pytest.raises(Failed, match=r"r1: no board answers \(.*No such file"):
        reboot(fleet_file(tmp_path, str(tmp_path / "nothing")), "r1", lambda line: None, limit_s=0.5)


def test_a_refusal_to_arm_names_the_way_out():
    arming = Arming()
    arming.want()
    line = arming.refused(1 << wire.ARM_CHECKS.index("fault latched"))
    assert line is not None and "aucamp board reboot" in line.text and failsafe.LATCHED == 4
    arming.want()
    line = arming.refused(1 << wire.ARM_CHECKS.index("leak"))
    assert line is not None and "put it right" in line.text
