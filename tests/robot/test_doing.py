"""What each order does to a moored robot, and that `resume` is the way back."""

from pathlib import Path

import pytest
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.config import Target
from agent.core.ranging.camera_model import gimbal_deg
from agent.core.step_io import TargetBox
from agent.demo.demo import demo_fleet
from tests.capabilities.light.lit_swarm import lit_fleet
from tests.known_lens import CAMERA
from tests.robot.ordering import FLEET, Ordering


@pytest.fixture
def robot() -> Ordering:
    """One that sees the ball and measures it."""
    robot = Ordering()
    assert any(outputs.sweep for outputs in robot.run(8.0))
    return robot


def looks_deg(robot: Ordering) -> tuple[float, float]:
    return gimbal_deg(CAMERA, FLEET.body, robot.outputs.set_point.servos_us[:2])


def state(robot: Ordering):
    while robot.step().state is None:
        pass
    return robot.outputs.state


def test_hold_is_a_depth_until_resume(robot) -> None:
    assert robot.outputs.set_point.depth_m == 0.4
    assert robot.give("hold", {"depth_m": 0.15}).ok
    assert {outputs.set_point.depth_m for outputs in robot.run(1.0)} == {0.15}
    assert robot.give("hold").ok  # as deep as it is told to be
    assert robot.outputs.set_point.depth_m == 0.15
    assert robot.give("resume").ok and robot.outputs.set_point.depth_m == 0.4


def test_look_takes_the_camera_from_the_target_and_resume_gives_it_back(robot) -> None:
    assert robot.give("look", {"pan_deg": -20.0, "tilt_deg": 5.0}).ok
    outputs = robot.run(6.0)
    assert looks_deg(robot) == pytest.approx((-20.0, 5.0), abs=0.3)
    assert not any(each.sweep for each in outputs[40:])
    assert robot.agent.measuring.current.estimator.t > 0  # iterations go on
    assert robot.give("look", {"pan_deg": 30.0}).ok
    robot.run(2.0)
    assert looks_deg(robot) == pytest.approx((30.0, 0.0), abs=0.3)
    assert robot.give("resume").ok
    assert any(each.sweep for each in robot.run(8.0))


def test_without_sweeps_nothing_is_measured(robot) -> None:
    assert robot.give("set", {"name": "sweeps", "value": 0.0}).ok
    assert not any(each.sweep for each in robot.run(6.0))
    assert robot.give("set", {"name": "sweeps", "value": 1.0}).ok
    assert any(each.sweep for each in robot.run(6.0))


def test_it_speaks_as_often_as_it_is_told(robot) -> None:
    def said(seconds: float) -> int:
        return sum(len(each.says) for each in robot.run(seconds)) // 2  # to two neighbours

    assert robot.give("set", {"name": "send_hz", "value": 4.0}).ok
    assert said(5.0) == pytest.approx(20, abs=1)
    assert robot.give("resume").ok
    assert 50 < said(5.0) <= 56, "rounds, and between them news: what it measured itself, once a second"


def test_previews_and_boxes_are_for_the_devices_once() -> None:
    box = Target(detector="box", picture="p.png", box=(1.0, 1.0, 20.0, 20.0))
    robot = Ordering(replace(FLEET, target={"ball": FLEET.target["ball"], "wreck": box}))
    assert robot.give("set", {"name": "preview_hz", "value": 0.5}).ok and robot.outputs.preview_hz == 0.5
    assert robot.step().preview_hz is UNSET
    drawn = {"frame": 7, "x": 600.0, "y": 10.0, "width": 40.0, "height": 20.5}
    assert robot.give("target_box", drawn).ok
    assert robot.outputs.box == TargetBox(target="wreck", frame=7, box=(600.0, 10.0, 40.0, 20.5))
    assert robot.step().box is UNSET
    for wrong in ({"x": 600.5}, {"width": 7.0}, {"target": "ball"}, {"y": -1.0}):
        assert not robot.give("target_box", {**drawn, **wrong}).ok and robot.outputs.box is UNSET
    assert robot.give("resume").ok and robot.outputs.preview_hz == FLEET.link.preview_hz


def test_a_lamp_burns_as_ordered_and_is_lent_to_nobody_meanwhile() -> None:
    robot = Ordering(lit_fleet())
    robot.run(2.0)
    assert robot.give("lamp", {"light": 0.25, "pan_deg": 30.0, "tilt_deg": -10.0}).ok
    robot.run(1.0)
    centre, per_deg = FLEET.body.servo_centre_us, FLEET.body.servo_us_per_deg
    assert robot.outputs.set_point.light == 0.25
    assert robot.outputs.set_point.servos_us[2:] == (round(centre + 30 * per_deg), round(centre - 10 * per_deg))
    assert (
        robot.agent.capabilities["light"].own.now.cannot == "busy"
        and robot.agent.capabilities["light"].own.now.power == 0.25
    )
    assert robot.give("lamp", {"light": 0.0}).ok
    assert {each.set_point.light for each in robot.run(1.0)} == {0.0}
    assert robot.give("resume").ok
    robot.run(1.0)
    assert robot.outputs.set_point.light == 1.0 and robot.agent.capabilities["light"].own.now.cannot == ""


def test_what_holds_is_shown_with_who_ordered_it_and_stands_in_the_log(robot) -> None:
    assert state(robot).ordered is UNSET
    robot.give("hold", {"depth_m": 0.2})
    robot.give("look", {"pan_deg": 5.0}, console="bob")
    robot.give("hold", {"depth_m": 0.3}, console="bob")
    robot.give("stop", console="cy")
    assert state(robot).ordered == ("bob: hold depth_m=0.3", "bob: look pan_deg=5 tilt_deg=0", "cy: stop")
    robot.give("resume")
    assert state(robot).ordered == ("cy: stop",)


def test_the_log_names_who_ordered_what_and_what_was_refused(robot) -> None:
    robot.give("hold", {"depth_m": 0.2})
    robot.give("hold", {"depth_m": 20.0}, console="bob")
    lines = [line.text for line in robot.outputs.log]
    robot.give("surface", console="cy")
    lines += [line.text for line in robot.outputs.log]
    assert lines[0].startswith("refuses what bob orders, hold depth_m=20: depth_m")
    assert lines[1] == "cy orders: surface"


def test_a_swim_that_ships_has_a_fleet_to_be_ordered_in() -> None:
    """The demo's own robots are on loopback: whoever sits there may order."""
    fleet = demo_fleet(2, "evidence", 0.0, 0, False, Path("/nowhere"))
    assert Ordering(fleet).give("stop").ok
