"""What a robot shows to be wrong: faults with their words in the state, news of them in the log, and no guesses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from msgspec import UNSET

from agent.core.messages import State
from agent.core.status import SELDOM_NS
from agent.core.step_io import Inputs, Telemetry
from agent.demo.demo import demo_fleet
from agent.robot.step import Agent
from tests.network.scripted_agent import CALIBRATION

FLEET = demo_fleet(3, "paper", 0.0, 0, False, Path("/nowhere"))
START_NS, STEP_NS = 10**18, 50_000_000


class Stepped:
    """An agent that is stepped at 20 Hz; `log` has the lines since it was last cleared."""

    def __init__(self) -> None:
        self.agent = Agent(FLEET, "r1", CALIBRATION, incarnation=7)
        self.now_ns = START_NS
        self.log: list[tuple[str, str]] = []

    def step(self, steps: int = 20, telemetry: dict[str, Any] | None = None, faults: tuple[str, ...] = ()) -> State:
        """The newest state; `telemetry`: what the module says in each step, None: it is silent."""
        for _ in range(steps):
            self.now_ns += STEP_NS
            heard = () if telemetry is None else (module(self.now_ns, **telemetry),)
            outputs = self.agent.step(Inputs(telemetry=heard, faults=faults), self.now_ns)
            self.log += [(line.level, line.text) for line in outputs.log]
        state = self.agent.current.last_state
        assert state is not None
        return state


def module(now_ns: int, armed: bool = True, ladder: int = 0, battery_v: float = 12.0) -> Telemetry:
    return Telemetry(
        t_ns=now_ns,
        board_us=1,
        depth_m=0.3,
        roll_deg=0.0,
        pitch_deg=0.0,
        sensor_depth_m=(0.3,) * 4,
        pulses_us=(1500,) * 8,
        servos_us=(1500,) * 4,
        battery_v=battery_v,
        armed=armed,
        ladder=ladder,
        flags=1,
        loop_us=5000,
    )


def test_nobody_knows_the_motors_of_a_module_that_is_silent():
    robot = Stepped()
    assert robot.step().armed is None, "it has never spoken"
    assert robot.step(telemetry={"armed": True}).armed is True
    assert robot.step(telemetry={"armed": False}).armed is False
    robot.step(telemetry={"armed": True})
    silent = robot.step()
    assert silent.armed is None and "no telemetry" in silent.faults
    assert robot.step(telemetry={"armed": True}).armed is True


def test_battery_and_failsafe_level_are_as_the_module_last_said():
    robot = Stepped()
    before = robot.step()
    assert before.battery_v is before.ladder is UNSET, "it has never spoken"
    said = robot.step(telemetry={"battery_v": 11.796, "ladder": 2})
    assert (said.battery_v, said.ladder) == (11.8, 2)
    silent = robot.step(40)
    assert (silent.armed, silent.battery_v, silent.ladder) == (None, 11.8, 2)
    again = robot.step(telemetry={"battery_v": 12.504, "ladder": 0})
    assert (again.battery_v, again.ladder) == (12.5, 0)


def test_a_failsafe_is_not_over_because_telemetry_stops():
    robot = Stepped()
    robot.step(telemetry={"ladder": 2})
    robot.log.clear()
    silent = robot.step(40)
    assert {"no telemetry", "failsafe level 2"} <= set(silent.faults)
    assert robot.log == [("warning", "no telemetry")]
    robot.log.clear()
    assert robot.step(telemetry={"ladder": 0}).faults == ("no frames",)
    assert ("info", "over: failsafe level 2") in robot.log and ("info", "over: no telemetry") in robot.log


def test_what_the_host_knows_to_be_wrong_is_a_fault_of_the_robot():
    robot = Stepped()
    robot.step(telemetry={})
    robot.log.clear()
    off = "motors off: to start them, end this agent"
    state = robot.step(telemetry={}, faults=(off, "not recording: the disk is full"))
    assert state.faults == ("no frames", off, "not recording: the disk is full")
    assert robot.log == [("warning", off), ("warning", "not recording: the disk is full")]
    robot.log.clear()
    assert robot.step(telemetry={}, faults=("not recording: the disk is full",)).faults[1:] == (
        "not recording: the disk is full",
    )
    assert robot.log == [("info", "over: motors off")]


def test_a_fault_whose_words_change_all_the_time_does_not_flood_the_log():
    robot = Stepped()
    robot.step(telemetry={})
    robot.log.clear()
    for number in range(200):
        state = robot.step(1, telemetry={}, faults=(f"frames frozen: for {number} steps",))
    assert "frames frozen: for 19" in " ".join(state.faults), "the state has the newest"
    assert 2 <= len(robot.log) <= 2 + 200 * STEP_NS // SELDOM_NS
    assert all(level == "warning" for level, _ in robot.log)
    robot.log.clear()
    robot.step(1, telemetry={})
    assert robot.log == [("info", "over: frames frozen")]


def test_a_long_text_does_not_make_a_state_too_large_for_others():
    assert len(Stepped().step(faults=("no camera: " + "x" * 10_000,)).faults[-1]) == 400
