"""When a robot knows enough to swim, and which frames it does not go by."""

import math

import numpy as np
import pytest
from msgspec.structs import replace

from agent.capabilities.swim.localizer import UNSURE_DEG, UNSURE_M, Carriage, Gimbal, Localizer, foresees, within
from agent.capabilities.swim.pose_filter import Drift, Hull, begin, predict
from agent.core.attitude import Attitude
from agent.core.config import Camera
from agent.core.step_io import SeenTags
from tests.capabilities.swim.swimming_agent import CALIBRATION, fleet
from tests.capabilities.swim.tank_with_tags import sight

SURE = (4e-6, 0.0, 0.0, 4e-6, 0.0, 1e-6)
FREE = Hull(drag=0.0, drag2=0.0, turn_drag=0.0, turn_drag2=0.0)
THETA = (1.0, 0.9, 0.7, 0.3, 0.0, 0.0, 0.0, math.radians(-30.0))
LEVEL = Carriage(Attitude(0.3, 0.0, 0.0), Gimbal((0.0, -30.0), True))


def known(velocity, rate, push, twist):
    """A belief with these standard deviations."""
    variances = np.array([0.0] * 3 + [velocity] * 2 + [rate] + [push] * 2 + [twist] + [0.0] * 2) ** 2
    belief = begin(0, (1.0, 1.0, 0.0), SURE)
    return belief._replace(P=tuple(map(tuple, (np.array(belief.P) * (np.eye(11) == 0) + np.diag(variances)).tolist())))


@pytest.mark.parametrize(
    ("sigmas", "may"),
    [
        ((0.01, 0.02, 0.015, 0.05), True),
        ((0.03, 0.02, 0.015, 0.05), False),  # m/s
        ((0.01, 0.06, 0.015, 0.05), False),  # rad/s
        ((0.01, 0.02, 0.050, 0.05), False),  # m/s^2
        ((0.01, 0.02, 0.015, 0.12), False),  # rad/s^2
    ],
)
def test_who_knows_its_motion_is_still_sure_in_a_second(sigmas, may) -> None:
    belief = known(*sigmas)
    assert foresees(belief) is may
    ahead = predict(belief, FREE, Drift(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 1_000_000_000)
    assert within(ahead, UNSURE_M, UNSURE_DEG) is may


def test_no_fix_by_a_rolling_shutter_while_the_robot_turns() -> None:
    for row_time_us, taken in ((0.0, True), (60.0, False)):
        one = Localizer(replace(fleet(), camera=Camera(row_time_us=row_time_us)), CALIBRATION)
        one.see(SeenTags(t_ns=10**9, frame=1, tags=tuple(sight(THETA))), LEVEL)
        began = one._ring._settled[-1]
        assert began.pose == pytest.approx(THETA[:3], abs=1e-3)
        one._ring._settled[-1] = began._replace(x=(*began.x[:5], math.radians(20.0), *began.x[6:]))
        one.see(SeenTags(t_ns=10**9 + 1_000_000, frame=2, tags=tuple(sight(THETA))), LEVEL)
        assert (one.refused == "") is taken and (len(one.events) == 1) is taken
