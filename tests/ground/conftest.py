"""The fleet that bridges and a person look at."""

import pytest

from agent.core.config import Fleet
from agent.robot.fleet_reader import load_fleet
from tests.places import ROOT


@pytest.fixture
def fleet() -> Fleet:
    return load_fleet(ROOT / "agent" / "fleets" / "tank.toml")
