"""A robot that swam to its pose once, for all who want to look at it."""

import numpy as np
import pytest

from tests.capabilities.swim.swimming_agent import POSE, InTank, fleet

THERE = POSE.x_m, POSE.y_m, POSE.yaw_deg
ASTRAY = (POSE.x_m + 0.24, POSE.y_m + 0.18, np.radians(POSE.yaw_deg + 20.0))  # 0.3 m and 20 degrees off


@pytest.fixture(scope="session")
def swum():
    """(robot, its inputs, outputs, way off and whether it knew, of each step): from astray, 16 s."""
    one, told = InTank(fleet(), ASTRAY, seed=3), []
    for _ in range(16 * 20):
        outputs = one.step()
        told.append((one.now_ns, one.inputs, outputs, one.off(*THERE), not one.swimmer.lost))
    return one, told
