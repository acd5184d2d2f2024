"""What the loop hands to the network of a step's outputs, and when it steps."""

from collections.abc import Callable
from queue import Empty, Queue
from threading import Event, Thread

import pytest
from msgspec import UNSET, UnsetType

from agent.clock.clock import SystemClock
from agent.core.codec import encode
from agent.core.messages import Estimate
from agent.core.step_io import Inputs, Outputs, Said, SetPoint, Sighting
from agent.process import agent_process
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


@pytest.mark.parametrize(("index", "found"), [(-1, True), (3, True), (-1, False)])
def test_a_frame_that_shows_a_target_makes_the_next_step(monkeypatch, index: int, found: bool) -> None:
    """One of a sweep waits for its turn, and so does one without a target."""
    monkeypatch.setattr(agent_process, "STEP_NS", 3_600 * 10**9)
    stepped, stop = Queue[int](), Event()
    runs = loop(Says(UNSET), lambda said: None)
    monkeypatch.setattr(runs, "step", stepped.put)
    thread = Thread(target=runs.run, args=(stop,))
    thread.start()
    try:
        assert stepped.get(timeout=60.0) == 0
        runs.show(
            [
                Sighting(t_ns=1, frame=1, target="ball", found=False),
                Sighting(t_ns=1, frame=1, index=index, target="ball", found=found),
            ]
        )
        if index < 0 and found:
            assert stepped.get(timeout=60.0) == 1
        else:
            with pytest.raises(Empty):
                stepped.get(timeout=0.1)
    finally:
        stop.set()
        runs.show([Sighting(t_ns=2, frame=2, target="ball", found=True)])
        thread.join()
