"""What the kernel says of each sweep in its outputs: the peak that it used, the place it gave, or why there is none."""

import math

import pytest
from msgspec.structs import replace

from agent.core.ranging.focus import Peak, fit_peak
from agent.core.step_io import Sighting, SweepOutcome
from agent.robot.fleet_reader import load_fleet
from tests.core.stepped_swarm import steps
from tests.network.scripted_agent import TARGET_M
from tests.places import ROOT

TANK = load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
FLEET = replace(TANK, robot={"r1": replace(TANK.robot["r1"], neighbours=())})
BEHIND_THE_WALL_M = (1.79, 1.256, 0.10)  # r1 looks there


@pytest.fixture(scope="module")
def dive() -> tuple[list[SweepOutcome], list[Sighting], list[str], int]:
    """Outcomes, sightings, log lines and the number of measurements of 20 s of one robot."""
    outcomes, sightings, lines, measurements = [], [], [], 0
    for _, inputs, outputs in steps(FLEET, 400):
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
    said = [(o.outcome, [line.text for line in o.log]) for _, _, o in steps(FLEET, 100, seen) if o.outcome]
    outcome, lines = said[0]
    assert outcome.lens_position is not None and outcome.x_m is None
    assert f"sweep rejected: {outcome.rejected}" in lines and "outside the tank" in outcome.rejected
