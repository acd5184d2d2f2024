"""What a robot shows to be wrong: faults with their words in the state, news of them in the log, and no guesses."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.messages import State
from agent.core.ranging.focus import Peak, fit_peak
from agent.core.status import SELDOM_NS
from agent.core.step_io import Inputs, Sighting, SweepOutcome, Telemetry
from agent.demo.demo import demo_fleet
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from tests.core.stepped_swarm import steps
from tests.network.scripted_agent import CALIBRATION, TARGET_M
from tests.places import ROOT

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
        state = self.agent.measuring.current.last_state
        assert state is not None
        return state


def module(now_ns: int, armed: bool = True, ladder: int = 0, battery_v: float = 12.0, **more: Any) -> Telemetry:
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
        **more,
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


def test_all_that_the_module_says_is_in_the_state_and_nothing_is_left_there():
    robot = Stepped()
    assert robot.step(telemetry={}).sensors_bad is UNSET
    status = {"current_a": 3.14, "temperature_c": 11.97, "heap_free_b": 51_300}
    said = robot.step(1, telemetry={"sensors_bad": 0b0101, "saturated": 2, "parameters_dirty": True, **status})
    said = robot.step(telemetry={"sensors_bad": 0b0101, "saturated": 2, "parameters_dirty": True})
    assert (said.sensors_bad, said.saturated, said.unsaved) == ((1, 3), "T5-T8", True)
    assert (said.current_a, said.water_c, said.heap_free_kb) == (3.1, 12.0, 51.3), "which is said once a second"
    assert "pressure sensor bad: 1 3" in said.faults
    after = robot.step(telemetry={})
    assert after.sensors_bad is after.saturated is after.unsaved is UNSET and after.faults == ("no frames",)
    assert ("info", "over: pressure sensor bad") in robot.log


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


# --- sweep outcomes ---
# What the kernel says of each sweep in its outputs: the peak that it used, the place it gave, or why there is none.

TANK = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
SWEEP_OUTCOMES_FLEET = replace(TANK, robot={"r1": replace(TANK.robot["r1"], neighbours=())})
BEHIND_THE_WALL_M = (1.79, 1.256, 0.10)  # r1 looks there


@pytest.fixture(scope="module")
def dive() -> tuple[list[SweepOutcome], list[Sighting], list[str], int]:
    """Outcomes, sightings, log lines and the number of measurements of 20 s of one robot."""
    outcomes, sightings, lines, measurements = [], [], [], 0
    for _, inputs, outputs in steps(SWEEP_OUTCOMES_FLEET, 400):
        sightings += inputs.sightings
        lines += [line.text for line in outputs.log]
        if outputs.outcome:
            outcomes.append(outputs.outcome)
        if outputs.state:
            measurements = outputs.state.measurements
    return outcomes, sightings, lines, measurements


def test_each_sweep_has_one_and_each_measurement_a_place(dive) -> None:
    outcomes, sightings, _, measurements = dive
    assert [outcome.sweep for outcome in outcomes] == sorted({s.sweep for s in sightings if s.sweep})
    placed = [outcome for outcome in outcomes if outcome.x_m is not None]
    assert len(placed) == measurements > 5
    assert all(math.dist(outcome.x_m, TARGET_M) < 0.02 and not outcome.rejected for outcome in placed)


def test_the_peak_is_the_one_that_the_logged_frames_give_with_the_logged_width(dive) -> None:
    outcomes, sightings, _, _ = dive
    assert outcomes[0].held_width is None and outcomes[1].held_width == outcomes[0].width
    for outcome in outcomes:
        good = [s for s in sightings if s.sweep == outcome.sweep and s.clarity is not None]
        peak = fit_peak([float(s.focus) for s in good], [s.clarity for s in good], outcome.held_width)
        assert isinstance(peak, Peak)
        assert (peak.lens_position, peak.width, peak.quality) == (outcome.lens_position, outcome.width, outcome.quality)
        assert outcome.t_ns in {s.t_ns for s in good}


def test_a_rejected_sweep_says_what_the_log_says() -> None:
    seen = {"r1": {"ball": BEHIND_THE_WALL_M}}
    said = [
        (o.outcome, [line.text for line in o.log]) for _, _, o in steps(SWEEP_OUTCOMES_FLEET, 100, seen) if o.outcome
    ]
    outcome, lines = said[0]
    assert outcome.lens_position is not None and outcome.x_m is None
    assert f"sweep rejected: {outcome.rejected}" in lines and "outside the tank" in outcome.rejected
