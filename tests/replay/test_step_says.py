"""What the loop hands to the network of a step's outputs."""

from collections.abc import Callable

import pytest
from msgspec import UNSET, UnsetType

from agent.clock.clock import SystemClock
from agent.core.messages import Estimate, Presence
from agent.core.step_io import Inputs, Outputs, SetPoint
from agent.process.agent_process import Runtime
from tests.sample_messages import presence

NEAR = presence("r1", "r2"), presence("r1", "r3")


class Says:
    """An agent that says that in each step."""

    def __init__(self, near: tuple[Presence, ...] | UnsetType) -> None:
        self.near = near

    def step(self, inputs: Inputs, now_ns: int) -> Outputs:
        self.faults = inputs.faults
        return Outputs(set_point=SetPoint(depth_m=0.3), near=self.near)


class Around:
    """Camera, control module and network; what is said goes to `hear`."""

    def __init__(self, hear: Callable[[Estimate | Presence], None]) -> None:
        self.say = hear

    def drain(self) -> tuple[tuple, tuple]:
        return (), ()

    def orders(self) -> tuple:
        return ()

    def send(self, set_point: SetPoint, now_ns: int) -> None: ...


class Blind(Around):
    def drain(self) -> tuple:
        return ()

    views = drain


def loop(agent: Says, hear: Callable[[Estimate | Presence], None]) -> Runtime:
    signed = pytest.fail  # of estimates alone
    ends = Blind(hear), Around(hear), Around(hear)
    return Runtime("r1", agent, *ends, lambda *record: None, SystemClock(), sign=signed)


@pytest.mark.parametrize("near", [NEAR, UNSET])
def test_each_neighbour_is_told_where_a_robot_that_swims_is(near: tuple[Presence, ...] | UnsetType) -> None:
    told: list[Estimate | Presence] = []
    loop(Says(near), told.append).step(0)
    assert tuple(told) == (near or ())


def test_a_network_that_cannot_take_it_is_a_fault_and_the_loop_goes_on() -> None:
    def closed(said: Estimate | Presence) -> None:
        raise OSError(f"{said.dst} is closed")

    agent = Says(NEAR)
    runs = loop(agent, closed)
    runs.step(0)
    runs.step(1)
    assert agent.faults == ("words: OSError: r2 is closed",)
