"""Where the gimbal pointed, by what it was told."""

import pytest

from agent.capabilities.swim.localizer import LAG_NS, REST_NS, GimbalLog
from agent.core.config import Body
from agent.core.control.pointing import APPROACH_NS, PLAY_US, Pointing
from agent.core.ranging.camera_model import servos_us
from tests.capabilities.swim.swimming_agent import CAMERA

BODY, SECOND, START_NS = Body(), 1_000_000_000, 10**18
PLAY_DEG = PLAY_US / BODY.servo_us_per_deg


@pytest.fixture
def turned():
    """(log, pointing): to 0 degrees and three seconds later to 30, each noted as late as may be."""
    pointing, log = Pointing(), GimbalLog(CAMERA, BODY)
    for k, pan_deg in enumerate((0.0, 30.0)):
        pointing.aim(servos_us(CAMERA, BODY, pan_deg, 0.0), START_NS + 3 * k * SECOND)
        log.add(pointing)
    return log, pointing


def test_at_rest_it_is_where_it_was_told(turned) -> None:
    log, pointing = turned
    for t_ns, pan_deg in ((pointing.told_ns - 1, 0.0), (pointing.last_leg_ns + REST_NS, 30.0), (10 * START_NS, 30.0)):
        gimbal = log.at(t_ns)
        assert gimbal.rests and gimbal.deg == pytest.approx((pan_deg, 0.0), abs=0.1)


def test_on_its_way_nobody_knows(turned) -> None:
    log, pointing = turned
    below_ns = pointing.last_leg_ns - APPROACH_NS
    for t_ns in (START_NS - 1, pointing.told_ns, below_ns, below_ns + LAG_NS - 1, pointing.last_leg_ns + LAG_NS - 1):
        assert log.at(t_ns) is None


def test_while_it_settles_it_is_about_there_first_below_the_goal(turned) -> None:
    log, pointing = turned
    for t_ns, deg in (
        (pointing.last_leg_ns - 1, (30.0 - PLAY_DEG, -PLAY_DEG)),
        (pointing.last_leg_ns + LAG_NS, (30.0, 0.0)),
        (pointing.last_leg_ns + REST_NS - 1, (30.0, 0.0)),
    ):
        gimbal = log.at(t_ns)
        assert not gimbal.rests and gimbal.deg == pytest.approx(deg, abs=0.1)
