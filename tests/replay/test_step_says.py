"""What the loop hands to the network of a step's outputs."""

from collections.abc import Callable

import pytest
from msgspec import UNSET, UnsetType

from agent.clock.clock import SystemClock
from agent.core.codec import encode
from agent.core.messages import Estimate
from agent.core.step_io import Inputs, Outputs, Said, SetPoint
from agent.process.agent_process import Runtime
from tests.sample_messages import presence

NEAR = tuple(Said(topic="near", to=to, payload=encode(presence("r1", to))) for to in ("r2", "r3"))


class Says:
    """An agent that says that in each step."""

    def __init__(self, outgoing: tuple[Said, ...] | UnsetType) -> None:
        self.outgoing = outgoing

    def step(self, inputs: Inputs, now_ns: int) -> Outputs:
        self.faults = inputs.faults
        return Outputs(set_point=SetPoint(depth_m=0.3), outgoing=self.outgoing)


class Around:
    """Camera, control module and network; what is said goes to `hear`."""

    def __init__(self, hear: Callable[[Estimate | Said], None]) -> None:
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


def loop(agent: Says, hear: Callable[[Estimate | Said], None]) -> Runtime:
    ends = Blind(hear), Around(hear), Around(hear)
    return Runtime("r1", agent, *ends, lambda *record: None, SystemClock())


@pytest.mark.parametrize("outgoing", [NEAR, UNSET])
def test_each_neighbour_is_told_what_capabilities_tell(outgoing: tuple[Said, ...] | UnsetType) -> None:
    told: list[Estimate | Said] = []
    loop(Says(outgoing), told.append).step(0)
    assert tuple(told) == (outgoing or ())


def test_a_network_that_cannot_take_it_is_a_fault_and_the_loop_goes_on() -> None:
    def closed(said: Estimate | Said) -> None:
        raise OSError(f"{said.to} is closed")

    agent = Says(NEAR)
    runs = loop(agent, closed)
    runs.step(0)
    runs.step(1)
    assert agent.faults == ("words: OSError: r2 is closed",)
