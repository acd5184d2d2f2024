"""Orders in a secured fleet: by consoles of the fleet file with their own certificates, and by nobody else."""

import contextlib
import time

import pytest
from msgspec.structs import replace

from agent.core.config import Access, ConfigError
from agent.core.topics import ANSWER
from agent.ground.console import OrderConsole
from agent.process.transport import Observer
from tests.network.orders.answering import Loop
from tests.network.secured.conftest import Secured
from tests.waiting import until


def test_a_console_orders_all_and_whoever_looks_sees_who_it_was(secured: Secured) -> None:
    fleet, keys = secured.fleet, secured.keys
    loops = [Loop(fleet, name, keys) for name in fleet.robot]
    with contextlib.ExitStack() as stack:
        for loop in loops:
            stack.enter_context(loop.transport)
            loop.start()
            stack.callback(loop.join)
            stack.callback(loop.ends.set)
        observer = stack.enter_context(Observer(fleet, time.time_ns, (ANSWER,), keys=keys))
        ann = stack.enter_context(OrderConsole(fleet, "ann", keys))
        until(lambda: len(ann.states()) == len(loops))
        seen: list[str] = []

        def shown() -> bool:
            assert all(outcome.ok for outcome in ann.order(fleet.robot, "stop").values())
            seen.extend(item.chunks["console"] for item in observer.drain())
            return len(seen) >= len(loops)

        until(shown)
        assert set(seen) == {"ann"} == {ordered.console for loop in loops for ordered in loop.taken}
        # Whoever has a certificate, but is no console to the robots, is not heard, whatever its own file says.
        own_file = replace(fleet, access=Access(keys=fleet.access.keys, observers=(), consoles=("eve", "view")))
        for name in ("eve", "view"):
            taken = [len(loop.taken) for loop in loops]
            with OrderConsole(own_file, name, keys) as stranger:
                outcomes = stranger.order(fleet.robot, "stop", answer_s=0.5, heard_s=1.0)
                assert not any(outcome.answer for outcome in outcomes.values())
            assert [len(loop.taken) for loop in loops] == taken


def test_who_is_no_console_is_told_so(secured: Secured) -> None:
    with (
        pytest.raises(ConfigError, match=r"\[access\] consoles names ann, bob"),
        OrderConsole(secured.fleet, "view", secured.keys),
    ):
        pass
