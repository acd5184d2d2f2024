"""The router: a place to look from. The swarm runs without it, and no link of the swarm passes through it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from agent.clock import machine
from agent.kernel import topics
from agent.kernel.config import ConfigError, Fleet
from replay.roll_call import RollCall
from router_config.door import Sample, Session
from router_config.session import ROUTER_LISTEN, router_config

PERIOD_S = 0.1  # between two looks who is there


def run_router(
    fleet: Fleet, stop: threading.Event, listen: str = ROUTER_LISTEN, say: Callable[[str], None] = lambda line: None
) -> None:
    """Dial every robot and serve clients on `listen` until `stop` is set; `say` gets lines for a person: where to look,
    and who is not heard.

    Raises ConfigError if it cannot listen.
    """
    heard: set[str] = set()

    def came(token: Sample) -> None:
        if (seen := topics.chunks(topics.ALIVE, token.key)) is not None:
            heard.add(seen["robot"])

    if not listen.startswith("tcp/"):
        raise ConfigError(f"--listen {listen}: no endpoint; write tcp/HOST:PORT, such as {ROUTER_LISTEN}")
    with Session(router_config(fleet, listen), f"--listen {listen}") as session:
        session.watch_tokens(topics.ALIVE.format(fleet=fleet.fleet, robot="*", session="*"), came)
        say(f"consoles attach to {listen}; Ctrl-C ends it")
        roll = RollCall(fleet, say)
        while not machine.wait(stop, PERIOD_S):
            roll.look(frozenset(heard))
        roll.end()
