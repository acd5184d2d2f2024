"""`aucamp board`: what pulses of thrusters say of wires, and a crew beside a robot of the twin that is checked."""

from __future__ import annotations

import json
import os
import sys
import threading
import time

import numpy as np
import pytest
from msgspec.structs import replace

from agent.core.config import ConfigError, dump
from agent.ground import board
from agent.process.command import Failed
from hw.firmware import failsafe
from hw.firmware.thrust import PITCH, ROLL
from hw.twin.physics.sensors import CORNERS
from tests.hw.firmware.diving_robot import FLEET, DivingRobot
from tests.hw.firmware.nominal_plant import AIR_PA
from tests.studies.single_faults import check, crossed, nothing, sensors

# --- from pulses to wires ---

RIGHT_M = 0.005 * (np.outer(PITCH, [1, -1, -1, 1]) - np.outer(ROLL, [1, 1, -1, -1]))


def test_a_pulse_lifts_its_own_corner():
    assert [int(row.argmin()) for row in RIGHT_M] == [0, 1, 2, 3]
    assert board.faults_of(RIGHT_M) == []


@pytest.mark.parametrize(
    ("leans_m", "says"),
    [
        (RIGHT_M * [[1], [1], [0], [1]], ["T3 gives nothing"]),
        (RIGHT_M * [[1], [-1], [1], [1]], ["T2 pushes the wrong way"]),
        (RIGHT_M[[0, 1, 3, 2]], ["the signals of T3 and T4 are crossed"]),
        (RIGHT_M[:, [3, 1, 2, 0]], ["sensors 1 and 4 are crossed"]),
        (RIGHT_M[:1, [3, 1, 2, 0]], ["sensors 1 and 4 are crossed"]),
        (RIGHT_M[[2, 1, 0, 3]], ["the signals of T1 and T3 are crossed", "sensors 1 and 3 are crossed"]),
        (RIGHT_M[[1, 2, 3, 0]], ["no single wire explains"]),
        (RIGHT_M[:2], ["the board stopped between two pulses"]),
        (0.1 * RIGHT_M, ["no thruster moves the robot"]),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_which_wire_is_wrong(leans_m, says, seed):
    """With a tenth of noise, and thrusters that differ by a tenth."""
    rng = np.random.default_rng(seed)
    seen_m = leans_m * rng.uniform(0.9, 1.1, (len(leans_m), 1)) + rng.normal(0, 0.0004, leans_m.shape)
    found = board.faults_of(seen_m - seen_m.mean(axis=1, keepdims=True))
    assert len(found) == len(says)
    assert all(text.startswith(what) for text, what in zip(sorted(found), sorted(says), strict=True))


def test_what_swings_on_is_taken_off():
    t_s = np.arange(0, 1, 0.02)
    before = np.column_stack([t_s, *[0.3 + 0.01 * k * t_s for k in range(4)]])
    after = np.array([[1.5, 0.3 + 0.02, 0.315, 0.33, 0.345]])
    np.testing.assert_allclose(board.sent_down(before, after), [0.02, 0, 0, 0], atol=1e-9)
    with pytest.raises(Failed, match="fell silent"):
        board.sent_down(before, np.zeros((0, 5)))


@pytest.mark.parametrize("text", ["net_weight_N", "=3", "law=pid"])
def test_a_parameter_that_is_no_number_is_one_line(text):
    with pytest.raises(ConfigError, match="write NAME=VALUE"):
        board.numbers([text])


def test_a_parameter_is_set_once():
    with pytest.raises(ConfigError, match="law is given twice; write it once"):
        board.numbers(["law=2", "net_weight_N=1.2", "law=1"])


# --- in the twin ---


class Crew:
    """Does what it is told, at one robot; but for what it leaves out."""

    def __init__(self, leaves_out: str = "nothing") -> None:
        self.leaves_out, self.told = leaves_out, list[str]()

    def __call__(self, robot: DivingRobot, text: str) -> None:
        self.told.append(text)
        robot.dive.states["held"] = 0
        if self.leaves_out in text:
            return
        if "open the kill switch" in text:
            robot.dive.turn_kill_switch("r1", "open")
        elif "close the kill switch" in text:
            robot.dive.turn_kill_switch("r1", "closed")
        elif "press down the corner" in text:
            corner = int(text.partition("corner ")[2][0]) - 1
            x, y = 0.13 * CORNERS[corner]
            robot.dive.push("r1", (0.0, 0.0, -1.2), (x, y, 0.0), 0.6)


def test_a_robot_whose_wires_are_right_passes_and_may_be_armed():
    crew = Crew()
    assert check(2, crew=crew) == ""
    assert sum("press down the corner" in text for text in crew.told) == 4


@pytest.mark.parametrize(
    ("wired", "leaves_out", "says"),
    [
        (sensors(1, 3), "nothing", "sensor 3 is at the corner 1, front left; swap their wires"),
        (crossed(1, 3), "nothing", "the signals of T1 and T3 are crossed"),
        (nothing, "open the kill switch", "its kill switch was not seen to open"),
    ],
)
def test_what_is_wrong_is_said(wired, leaves_out, says):
    assert says in check(2, wired, Crew(leaves_out))


# --- at a desk ---


@pytest.fixture
def at_desk(put_on_desk, tmp_path):
    """A board whose clock goes on, and a fleet file that names its port."""
    desk = put_on_desk(sys.executable, {"tare_pa": [AIR_PA] * 4, "wiring": failsafe.WIRING})
    desk.listen = lambda: None
    robots = {"r1": replace(FLEET.robot["r1"], serial=os.ttyname(desk.slave), camera="v4l2:/dev/video0")}
    path = tmp_path / "fleet.toml"
    path.write_text(dump(replace(FLEET, robot=robots)))
    stop = threading.Event()

    def go_on() -> None:
        while not stop.is_set():
            desk.tick()
            time.sleep(0.002)

    ticking = threading.Thread(target=go_on)
    ticking.start()
    yield desk, path
    stop.set()
    ticking.join()


def test_info_tare_and_params(at_desk):
    desk, path = at_desk
    said: list[str] = []
    board.run("info", path, "r1", said.append)
    assert any("firmware aucamp06" in line for line in said) and any("tared" in line for line in said)
    assert any("battery 15.00 V, 1.0 A" in line for line in said)
    desk.pressure_pa = [AIR_PA + 40.0] * 4
    board.run("tare", path, "r1", said.append)
    assert json.loads(desk.flash_path.read_text())["tare_pa"] == pytest.approx([AIR_PA + 40.0] * 4)
    board.run("params", path, "r1", said.append, {"net_weight_N": -1.5})
    assert any(line.startswith("net_weight_N") and "-1.5 N" in line for line in said)
    assert json.loads(desk.flash_path.read_text())["net_weight_N"] == -1.5
    with pytest.raises(ConfigError, match="net_weight_N = 99: write a number from"):
        board.run("params", path, "r1", said.append, {"net_weight_N": 99.0})
    desk.pressure_pa[2] += 5000.0
    with pytest.raises(Failed, match="no tare: refused; lay it down in air"):
        board.run("tare", path, "r1", said.append)
    desk.pressure_pa = [AIR_PA + 4000.0] * 4
    with pytest.raises(Failed, match=r"no tare: its sensors read \+0.4\d m .* say --depth 0"):
        board.run("tare", path, "r1", said.append)
    board.run("tare", path, "r1", said.append, depth_m=0.0)
