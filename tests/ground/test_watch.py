"""`aucamp watch`: a line for each robot, in plain words."""

import pytest

from agent.core.config import Fleet
from agent.ground.observe import SILENT_S, line_of
from tests.ground.bridges.states import state


def test_a_line_says_what_a_robot_knows_and_what_is_wrong(fleet: Fleet) -> None:
    said = state(posterior_m=(0.5, 0.25, 0.1), posterior_sigma_m=0.0012, faults=("camera: gone",), battery_v=15.8)
    line = line_of("r1", fleet, (said, 10.0), 10.5)
    for words in ("at 0.500 0.250 0.100 m +- 1.2 mm", "consistent", "camera: gone", "15.8 V"):
        assert words in line
    assert "\n" not in line and "silent" not in line
    assert line_of("r1", fleet, (said, 10.0), 11.0 + SILENT_S).endswith("silent for 3 s")
    assert line_of("r2", fleet, None, 10.0) == "r2  not heard"


@pytest.mark.parametrize("hostile", ["\x1b[2J", "a\nb"])
def test_what_a_stranger_says_does_not_move_the_cursor(fleet: Fleet, hostile: str) -> None:
    line = line_of("r1", fleet, (state(faults=(hostile,)), 0.0), 0.0)
    assert "\x1b" not in line and "\n" not in line
