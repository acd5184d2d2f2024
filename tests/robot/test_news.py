"""News goes from robot to robot in steps, not in rounds, and no link carries more than the fleet file asks of it."""

from collections import defaultdict
from itertools import pairwise
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import Link
from agent.core.target_state import BETWEEN_NS
from agent.demo.demo import demo_fleet
from tests.core.stepped_swarm import START_NS, STEP_NS, steps
from tests.network.scripted_agent import TARGET_M

ROBOTS = 5
SECONDS = 12
UNSEEN_M = (0.76, 0.56, 50.0)  # far above the camera's view


def in_a_line(send_hz: float):
    """Robots of which each speaks to the next, and the last alone sees the ball."""
    fleet = demo_fleet(ROBOTS, "evidence", 0.0, 0, False, Path("/nowhere"))
    names = sorted(fleet.robot, reverse=True)  # r1 finds the ball at once
    near = {name: tuple(names[j] for j in (i - 1, i + 1) if 0 <= j < ROBOTS) for i, name in enumerate(names)}
    robots = {name: replace(fleet.robot[name], neighbours=near[name]) for name in names}
    return replace(fleet, robot=robots, link=Link(send_hz=send_hz))


def spoken(send_hz: float):
    """When each robot spoke to each neighbour, and when it first told of the last robot's samples, in steps."""
    fleet, said_ns, told = in_a_line(send_hz), defaultdict(list), {}
    first, *_, last = fleet.robot
    visible = {name: {"ball": TARGET_M if name == last else UNSEEN_M} for name in fleet.robot}
    now_ns = START_NS
    for name, _, outputs in steps(fleet, SECONDS * 20, visible):
        now_ns += STEP_NS if name == first else 0
        for said in outputs.says:
            said_ns[name, said.dst].append(now_ns)
            if said.gossip.entries:
                told.setdefault(name, (now_ns - START_NS) // STEP_NS)
    return fleet, said_ns, told


def test_news_crosses_a_line_one_robot_a_step() -> None:
    fleet, said_ns, told = spoken(10.0)
    names = list(fleet.robot)  # they step in this order: each hears in the next step what the one after it said
    assert [told[name] - told[names[-1]] for name in names[:0:-1]] == list(range(ROBOTS - 1))
    for times in said_ns.values():
        assert min(b - a for a, b in pairwise(times)) >= BETWEEN_NS
        assert 10 * SECONDS <= len(times) <= 20 * SECONDS


@pytest.mark.parametrize("send_hz", [0.5, 5.0])
def test_a_link_that_is_asked_for_less_carries_no_more(send_hz) -> None:
    _, said_ns, told = spoken(send_hz)
    assert told
    for times in said_ns.values():
        assert abs(len(times) - send_hz * SECONDS) <= 1
        assert min(b - a for a, b in pairwise(times)) >= 0.99e9 / send_hz
