"""What is found while a robot rises because its host was silent: it is kept, and nobody calls the robot back unseen."""

from __future__ import annotations

from typing import Any

import pytest

from hw.firmware import failsafe, wire
from hw.firmware.failsafe import DISARM, SURFACE
from hw.module import surfacing_for_silence
from tests.hw.firmware.bare_board import BareBoard
from tests.hw.firmware.diving_robot import diving_robot
from tests.hw.firmware.test_failsafe import at_rest, climb


def rising() -> Any:
    ladder = climb(4.0, age_s=4.0)
    assert ladder.level == SURFACE and not ladder.found()
    return ladder


@pytest.mark.parametrize(
    ("seconds", "situation", "reason"),
    [
        (0.01, {"leak": True}, "leak"),
        (2.1, {"low": True}, "battery low"),
        (0.01, {"disagree": True}, "sensors disagree"),
        (0.01, {"leans": True}, "attitude contradicts the thrust that it takes"),
        (0.01, {"bad_count": 1}, "a sensor is bad"),
    ],
)
def test_what_is_found_on_the_way_up_stays_found_up_there_too(seconds, situation, reason):
    ladder = climb(seconds, ladder=rising(), **situation)
    assert (ladder.level, wire.REASONS[ladder.reason]) == (SURFACE, reason) and ladder.found()
    climb(1.0, ladder=ladder, leak=reason != "leak")
    assert wire.REASONS[ladder.reason] == reason, "the first stands, though it has gone and there is another"
    climb(2.1, ladder=ladder, depth_m=0.05)
    assert (ladder.level, wire.REASONS[ladder.reason]) == (DISARM, "surfaced") and ladder.found()
    assert wire.REASONS[ladder.finding] == reason
    assert ladder.resume() and not ladder.found()


def test_a_rise_with_nothing_found_says_so_to_its_end():
    ladder = climb(2.1, ladder=rising(), depth_m=0.05)
    assert ladder.level == DISARM and not ladder.found()


@pytest.mark.parametrize(
    ("suspected", "level"),
    [("T2 gives little or nothing", SURFACE), ("T2 pushes the wrong way", DISARM)],
)
def test_a_thruster_is_suspected_on_the_way_up_too_but_not_on_top_of_a_finding(suspected, level):
    reason = wire.REASONS.index(suspected)
    ladder = rising()
    ladder.suspect(reason)
    assert (ladder.level, ladder.reason) == (level, reason) and ladder.found()
    leaky = climb(0.01, ladder=rising(), leak=True)
    leaky.suspect(reason)
    assert (leaky.level, wire.REASONS[leaky.reason]) == (SURFACE, "leak")
    leaky.surface(wire.REASONS.index("control fault"))
    assert wire.REASONS[leaky.reason] == "leak"


def test_an_order_to_surface_hides_no_silence_and_no_finding():
    ladder = rising()
    ladder.surface(wire.REASONS.index("order"))
    assert wire.REASONS[ladder.reason] == "host silent"
    ladder.surface(wire.REASONS.index("control fault"))
    assert wire.REASONS[ladder.reason] == "control fault" and ladder.found()


def test_another_moment_of_a_robot_that_rises_contradicts_nothing():
    board = BareBoard()
    board.arm()
    board.control.ladder.surface(wire.REASONS.index("host silent"))
    board.hold(20)
    assert not board.control._still


def test_a_finding_on_the_way_up_is_told_and_shown(tmp_path):
    with diving_robot(tmp_path) as robot:
        robot.arm()
        robot.talks = False
        robot.until(lambda: robot.ladder == SURFACE, 4.0)
        assert surfacing_for_silence(robot.telemetry[-1])
        robot.dive.kill_sensor("r1", 3)
        robot.run(0.2)
        robot.dive.mend_sensor("r1", 3)
        robot.run(1.2)
        newest = robot.telemetry[-1]
        assert not newest.flags & wire.FLAG_DEGRADED and newest.flags & wire.FLAG_FOUND
        assert robot.heard("failsafe level 2 -> 2: a sensor is bad") and not surfacing_for_silence(newest)
        robot.until(lambda: not robot.armed, 8.0)
        robot.run(1.0)
        assert at_rest(robot) and robot.telemetry[-1].flags & wire.FLAG_FOUND


def test_a_thruster_that_turns_round_on_the_way_up_stops_the_motors(tmp_path):
    with diving_robot(tmp_path) as robot:
        robot.arm()
        robot.talks = False
        robot.until(lambda: robot.ladder == SURFACE, 4.0)
        robot.dive.scale_thruster("r1", 1, -1.0)
        robot.until(lambda: not robot.armed, 3.5)
        robot.run(0.5)
        assert robot.telemetry[-1].flags & wire.FLAG_FOUND
        assert robot.ladder == failsafe.DISARM and not robot.heard("surfaced")
