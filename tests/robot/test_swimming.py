"""Orders to a robot that swims: what its fleet file could say as its behaviour, and the way back to that."""

import numpy as np
import pytest

from agent.core.codec import encode
from agent.core.messages import Answer, Order
from agent.core.step_io import Ordered
from tests.capabilities.swim.swimming_agent import InTank, fleet


class Told(InTank):
    """A robot in its tank that somebody orders about."""

    numbers = 0

    def give(self, verb: str, **args) -> Answer:
        self.numbers += 1
        order = Order(id=self.numbers, verb=verb, args=args, seen=(7, self.now_ns))
        outputs = self.step(orders=(Ordered(arrived_ns=self.now_ns, console="ann", payload=encode(order)),))
        return outputs.answers[0]


@pytest.fixture
def robot() -> Told:
    """One that knows where it is and holds its pose."""
    robot = Told(fleet())
    assert robot.until(lambda: robot.swimmer.under_way, 12.0)
    robot.run(2.0)
    return robot


def test_goto_hold_and_back_home(robot) -> None:
    home = tuple(robot.body.at)
    assert robot.give("goto", x_m=1.6, y_m=1.0, yaw_deg=40.0, depth_m=0.2).ok
    robot.run(15.0)
    assert robot.off(1.6, 1.0, 40.0)[0] < 0.06
    assert robot.outputs.set_point.depth_m == 0.2 and robot.state.behaviour == "goto"
    assert robot.state.ordered == ("ann: goto x_m=1.6 y_m=1 depth_m=0.2 yaw_deg=40",)
    assert robot.give("resume").ok
    robot.run(15.0)
    assert robot.off(home[0], home[1], 40.0)[0] < 0.06
    assert robot.outputs.set_point.depth_m == 0.3 and robot.state.behaviour == "hold"


def test_hold_stays_where_it_is_on_its_way(robot) -> None:
    assert robot.give("goto", x_m=2.2, y_m=1.0, yaw_deg=40.0).ok
    robot.run(3.0)
    assert robot.give("hold", depth_m=0.25).ok
    at = tuple(robot.body.at)
    robot.run(5.0)
    assert np.hypot(robot.body.at[0] - at[0], robot.body.at[1] - at[1]) < 0.15 and robot.body.at[0] < 2.0
    assert robot.outputs.set_point.depth_m == 0.25


def test_it_swims_no_faster_than_it_is_told(robot) -> None:
    assert robot.give("set", name="speed_m_s", value=0.05).ok
    assert robot.give("goto", x_m=2.2, y_m=1.0, yaw_deg=40.0).ok
    start_x = robot.body.at[0]
    robot.run(10.0)
    assert 0.1 < robot.body.at[0] - start_x < 0.55


@pytest.mark.parametrize(
    ("verb", "args", "why"),
    [
        ("goto", {"x_m": 0.05, "y_m": 1.0}, "from a wall"),
        ("goto", {"x_m": 1.0, "y_m": 1.0, "depth_m": 0.9}, "below the floor"),
        ("goto", {"x_m": 1.0, "y_m": 1.0, "depth_m": 0.01}, "not within"),
        ("follow", {"target": "wreck", "standoff_m": 0.5}, "no target 'wreck'"),
        ("orbit", {"x_m": 1.5, "y_m": 1.0, "radius_m": 0.4, "speed_m_s": 2.0}, "faster"),
        ("survey", {}, "is no survey"),
        ("set", {"name": "speed_m_s", "value": 3.0}, "not within"),
    ],
)
def test_where_it_cannot_swim_it_is_not_sent(robot, verb: str, args: dict, why: str) -> None:
    answer = robot.give(verb, **args)
    assert not answer.ok and why in answer.why
    assert robot.swimmer.does == "hold"


def test_all_behaviours_begin(robot) -> None:
    for verb, args in (
        ("turn", {"yaw_deg": 90.0}),
        ("orbit", {"x_m": 1.5, "y_m": 1.0, "radius_m": 0.4}),
        ("follow", {"target": "ball", "standoff_m": 0.5, "search": True}),
        ("search", {"target": "ball"}),
        ("trial", {"x_m": 1.5, "y_m": 1.0}),
    ):
        assert robot.give(verb, **args).ok
        robot.run(0.5)
        assert robot.swimmer.active.behaviour.__struct_config__.tag == verb


def test_a_look_gives_way_to_landmarks(robot) -> None:
    """Who looks elsewhere for long would not know where it is."""
    assert robot.give("look", pan_deg=60.0, tilt_deg=-20.0).ok
    robot.run(30.0)
    assert not robot.swimmer.lost
