"""Pressure sensors that repeat themselves for ever: several at once, under way and before arming."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from hw.firmware import wire
from hw.module import Arming
from tests.hw.firmware.bare_board import BareBoard
from tests.hw.firmware.diving_robot import HOVER, REST_N, diving_robot


@pytest.mark.parametrize(
    ("which", "within_s", "reason"),
    [
        ((1, 2), 0.4, "two sensors bad"),
        ((1, 4), 0.4, "two sensors bad"),
        ((1, 2, 4), 0.4, "two sensors bad"),
        ((1, 2, 3, 4), 0.7, "sensors stand still"),
    ],
)
def test_several_that_freeze_at_once_stop_the_motors(tmp_path, which, within_s, reason):
    """On the way to another depth: what the law cannot see it cannot right."""
    with diving_robot(tmp_path) as robot:
        robot.arm()
        robot.asks = msgspec.structs.replace(HOVER, depth_m=0.3)
        for sensor in which:
            robot.dive.stick_sensor("r1", sensor)
        robot.until(lambda: not robot.armed, within_s)
        tilts_deg = []
        for _ in range(100):
            robot.run(0.01)
            tilts_deg.append(robot.tilt_deg)
        assert robot.heard(reason) and np.all(robot.thrust_n < REST_N) and max(tilts_deg) < 45.0


@pytest.mark.parametrize("which", [(1, 2), (1, 2, 3, 4)])
def test_a_robot_that_hovers_does_not_turn_over_meanwhile(tmp_path, which):
    with diving_robot(tmp_path) as robot:
        robot.arm()
        for sensor in which:
            robot.dive.stick_sensor("r1", sensor)
        tilts_deg = []
        while robot.armed:
            robot.run(0.01)
            tilts_deg.append(robot.tilt_deg)
        assert max(tilts_deg) < 12.0 and len(tilts_deg) < 80


def test_a_robot_whose_sensors_all_stand_still_does_not_arm():
    board = BareBoard()
    board.hal.frozen = True
    board.greet()
    board.tick(301)
    board.set_point()
    board.tick()
    assert board.answers(wire.ARM, 1, board.boot_id)[0][1][2] == wire.REFUSED
    board.tick(3)
    (refused,) = {event[5] for event in board.heard(wire.EVENT) if event[1] == wire.EV_ARM_REFUSED}
    assert refused == 1 << wire.ARM_CHECKS.index("sensors not all good")
    board.hal.frozen = False
    board.hold(110)
    assert board.answers(wire.ARM, 2, board.boot_id)[0][1][2] == wire.OK


def test_a_robot_that_is_upside_down_is_refused_in_words():
    """The last of the checks is the sign of the number that they go in."""
    board = BareBoard()
    board.hal.gravity = (-1000, 0)
    board.greet()
    board.hold(305)
    assert board.answers(wire.ARM, 1, board.boot_id)[0][1][2] == wire.REFUSED
    board.tick(3)
    (refused,) = {event[5] for event in board.heard(wire.EVENT) if event[1] == wire.EV_ARM_REFUSED}
    arming = Arming()
    arming.want()
    line = arming.refused(refused)
    assert line is not None and line.text == "arming refused: upside down; put it right, then arm again"
