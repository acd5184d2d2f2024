"""Two agents of one name, and robots of another fleet, are told to whoever stands at the tank. Real sessions."""

import os
import time
from collections.abc import Callable
from contextlib import ExitStack

import pytest
from msgspec.structs import replace

from agent.core import topics
from agent.core.config import Fleet
from agent.process.links import FOREIGN, LASTING_S, SESSIONS, Tokens
from agent.process.transport import Transport
from tests.network.conftest import unused_port
from tests.network.rogue import Rogue
from tests.waiting import until

FULL = {"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")}

Fleets = Callable[..., Fleet]


def elsewhere(fleet: Fleet, name: str) -> Fleet:
    """The same file on another computer, where the address of `name` is free."""
    robot = replace(fleet.robot[name], listen=f"tcp/127.0.0.1:{unused_port()}")
    return replace(fleet, robot={**fleet.robot, name: robot})


def test_a_second_agent_of_a_name_is_told_to_its_neighbours_and_to_the_first(make_fleet: Fleets) -> None:
    fleet = make_fleet(FULL)
    with ExitStack() as stack:
        r1, r2, r3 = (stack.enter_context(Transport(fleet, name, time.time_ns)) for name in FULL)
        with Transport(elsewhere(fleet, "r3"), "r3", time.time_ns) as second:
            until(lambda: r1.faults() == ("two agents: two linked to us are called r3; end one",))
            until(lambda: r2.faults() == ("two agents: two linked to us are called r3; end one",))
            both = tuple(f"two agents: {name} is linked to two called r3; end one" for name in ("r1", "r2"))
            until(lambda: r1.faults() and r2.faults() and r3.faults() == second.faults() == both)
        until(lambda: not any([r1.faults(), r2.faults(), r3.faults()]))


def test_an_agent_of_our_own_name_that_is_linked_to_us(make_fleet: Fleets) -> None:
    fleet = make_fleet(FULL)
    with Transport(fleet, "r1", time.time_ns) as r1, Rogue(fleet, "r1") as rogue:
        rogue.token(topics.ALIVE.format(fleet="test", robot="r1", session="abc"))
        until(lambda: r1.faults() == ("two agents: another one called r1 is linked to us; end one",))


def test_a_robot_of_another_fleet_at_a_neighbours_address(make_fleet: Fleets) -> None:
    fleet = make_fleet(FULL)
    with Transport(fleet, "r2", time.time_ns) as r2:
        with Transport(replace(fleet, fleet="lake"), "r1", time.time_ns) as r1:
            says = "another fleet: {} is of fleet {}, not {}; write one name in both fleet files"
            until(lambda: r2.faults() == (says.format("r1", "lake", "test"),))
            until(lambda: r1.faults() == (says.format("r2", "test", "lake"),))
        until(lambda: r2.faults() == ())


def test_a_restart_is_no_second_agent(make_fleet: Fleets) -> None:
    fleet = make_fleet(FULL)
    with Transport(fleet, "r1", time.time_ns) as r1:
        for _ in range(3):
            with Transport(fleet, "r2", time.time_ns):
                until(lambda: r1._tokens._since_s["r2"])
        assert r1.faults() == ()


class Token:
    is_put = True

    def __init__(self, key: str) -> None:
        self.key = key


def alive(fleet: str = "test", robot: str = "r2", session: str = "a") -> Token:
    return Token(topics.ALIVE.format(fleet=fleet, robot=robot, session=session))


@pytest.fixture
def tokens(make_fleet: Fleets) -> Tokens:
    return Tokens(make_fleet(FULL), "r1")


def told(tokens: Tokens, now_s: float) -> tuple[str, ...]:
    return tokens.faults("00", lambda key: lambda: None, now_s)


def test_two_are_two_only_when_a_lost_link_cannot_be_the_reason(tokens: Tokens) -> None:
    tokens.token(alive(session="a"), 0.0)
    tokens.token(alive(session="b"), 10.0)
    assert told(tokens, 9.9 + LASTING_S) == ()
    assert len(told(tokens, 10.0 + LASTING_S)) == 1


def test_a_thousand_tokens_take_no_room(tokens: Tokens) -> None:
    for k in range(1000):
        tokens.token(alive(session=f"{k:x}"), 0.0)
        tokens.token(alive(fleet=f"f{k}"), 0.0)
        tokens.token(alive(robot=f"x{k}"), 0.0)
        tokens.token(alive(fleet="f" * 1000), 0.0)
        tokens.token(Token(topics.TWICE.format(fleet="test", robot="r1", witness=f"x{k}")), 0.0)
    assert {name: len(since_s) for name, since_s in tokens._since_s.items()} == {"r1": 0, "r2": SESSIONS, "r3": 0}
    assert len(tokens._foreign) == FOREIGN
    assert len(told(tokens, LASTING_S)) == 1 + FOREIGN
    assert all(len(text) < 120 for text in told(tokens, LASTING_S))


def test_what_no_agent_would_announce_is_nothing(tokens: Tokens) -> None:
    for text in ("", "x", "aucamp/test/alive/r2", f"aucamp/test/alive/r2/{os.urandom(4)!r}", "aucamp/A B/alive/r2/a"):
        tokens.token(Token(text), 0.0)
    assert told(tokens, LASTING_S) == ()
