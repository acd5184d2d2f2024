"""A robot whose board does not keep its cycle: who arms it, and how it hovers."""

import msgspec
import numpy as np
import pytest

from hw.twin.board import NO_TIME
from hw.twin.scene import SlowBoard
from tests.hw.firmware.diving_robot import diving_robot

CYCLE_US, OVERRUN_US = 5000.0, 13_333.0  # every cycle, whatever there is to do


def taking(cycle_us):
    return msgspec.structs.replace(NO_TIME, armed_us=cycle_us, disarmed_us=cycle_us)


def test_a_board_that_takes_13_ms_is_not_armed(tmp_path):
    with diving_robot(tmp_path, times=taking(OVERRUN_US)) as robot:
        robot.protocol.arm()
        robot.run(5.0)
        assert robot.heard("control cycle too slow")
        assert not robot.armed
        assert max(robot.dive._pulses_us[0]) == 1500


def test_the_board_that_ships_is_armed_and_hovers(tmp_path):
    with diving_robot(tmp_path) as robot:
        robot.arm()
        assert not robot.heard("slow")


def hovering_deg(robot, seconds):
    """Root mean square of the tilt."""
    tilts = []
    for _ in range(round(100 * seconds)):
        robot.run(0.01)
        tilts.append(robot.tilt_deg)
    return float(np.sqrt(np.mean(np.square(tilts))))


@pytest.mark.slow
def test_a_robot_rolls_where_its_board_loses_every_fourth_tick(tmp_path):
    fault = SlowBoard(at_s=14.0, robot="r1", by=OVERRUN_US / CYCLE_US)
    with diving_robot(tmp_path, [fault], taking(CYCLE_US)) as robot:
        robot.arm()
        before_deg = hovering_deg(robot, 3.0)
        robot.until(lambda: robot.dive.ticks >= 1400, 10.0)
        first = len(robot.telemetry)
        robot.run(1.0)
        after_deg = hovering_deg(robot, 3.0)
        assert robot.armed
        assert len(robot.telemetry) - first == pytest.approx(0.75 * 50 * 4, abs=3)
    assert before_deg < 0.2
    assert after_deg > 1.3 * before_deg
