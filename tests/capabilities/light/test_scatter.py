"""What a sweep by light from aside is worth: its peak and the middle of its outline are known less well."""

import pytest

from agent.capabilities.light.model import SCATTERS, WANDERS_PX
from agent.core.ranging.camera_model import Eye, camera_pose
from agent.core.ranging.fix import CENTRE_NOISE_PX, Outline
from agent.core.ranging.sweep import Measurement
from agent.robot.step import Agent
from tests.capabilities.light.lit_swarm import lit_fleet
from tests.network.scripted_agent import CALIBRATION

PEAK = Measurement(1, 10**9, 190.0, 0.8, 119.0, None, Outline((320.0, 240.0), 60.0, 1.0, 190.0), 0.99)


def eye() -> Eye:
    fleet = lit_fleet()
    robot = fleet.robot["r1"]
    return camera_pose(robot.pose, fleet.body, robot.depth_m, 0.0, 0.0, 0.0, 0.0, fleet.tank.surface_m)


@pytest.mark.parametrize(("burned", "aside"), [((), False), (("r1",), False), (("r2",), True), (("r1", "r2"), True)])
def test_by_anothers_lamp_a_peak_scatters_and_an_outline_wanders(burned, aside) -> None:
    fleet = lit_fleet()
    lights = Agent(fleet, "r1", CALIBRATION, 1).equipment.light
    lights._turn.burned = burned
    outline, sigma, cues = lights.corrected(PEAK, eye(), fleet.target["ball"], "both")
    assert sigma == PEAK.sigma * (SCATTERS if aside else 1.0)
    assert outline.centre_sigma_px == (WANDERS_PX if aside else CENTRE_NOISE_PX)
    assert cues == ("focus" if aside else "both")


def test_by_day_nothing_of_it_is_known() -> None:
    fleet = lit_fleet(lighting=None)
    lights = Agent(fleet, "r1", CALIBRATION, 1).equipment.light
    assert lights.corrected(PEAK, eye(), fleet.target["ball"], "both") == (PEAK.outline, PEAK.sigma, "both")
