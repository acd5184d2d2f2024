"""The router: a place to look from. The swarm runs without it, and no link of the swarm passes through it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from agent.clock import machine
from agent.core import topics
from agent.core.config import ConfigError, Fleet
from agent.process.certificates import certificate_file, hosts_of, read_certificate
from replay.roll_call import RollCall
from router_config.door import Sample, Session
from router_config.session import ROUTER, ROUTER_LISTEN, ROUTER_LISTEN_SECURED, router_config

PERIOD_S = 0.1  # between two looks who is there


def run_router(
    fleet: Fleet,
    stop: threading.Event,
    listen: str | None = None,
    say: Callable[[str], None] = lambda line: None,
    keys: Path | None = None,
) -> None:
    """Dial every robot and serve clients on `listen` until `stop` is set; `say` gets lines for a person: where to look,
    and who is not heard. `keys`: the folder of a secured fleet's certificates; its clients need one, too.

    Raises ConfigError if it cannot listen.
    """
    listen = listen or (ROUTER_LISTEN if keys is None else ROUTER_LISTEN_SECURED)
    heard: set[str] = set()

    def came(token: Sample) -> None:
        if (seen := topics.chunks(topics.ALIVE, token.key)) is not None:
            heard.add(seen["robot"])

    check_listen(listen, keys)
    with Session(router_config(fleet, listen, keys), f"--listen {listen}") as session:
        session.watch_tokens(topics.ALIVE.format(fleet=fleet.fleet, robot="*", session="*"), came)
        say(f"consoles attach to {listen}; Ctrl-C ends it")
        roll = RollCall(fleet, say)
        while not machine.wait(stop, PERIOD_S):
            roll.look(frozenset(heard))
        roll.end()


def check_listen(listen: str, keys: Path | None) -> None:
    """Raises ConfigError where clients could not attach, or everybody could."""
    if keys is None:
        if not listen.startswith("tcp/"):
            raise ConfigError(f"--listen {listen}: no endpoint; write tcp/HOST:PORT, such as {ROUTER_LISTEN}")
        return
    if not listen.startswith("tls/"):
        raise ConfigError(
            f"--listen {listen}: the fleet is secured; write tls/HOST:PORT, such as {ROUTER_LISTEN_SECURED}"
        )
    host, good = listen.partition("/")[2].rpartition(":")[0], hosts_of(read_certificate(certificate_file(keys, ROUTER)))
    if host not in good:
        raise ConfigError(
            f"--listen {listen}: the router's certificate is good at {' and '.join(good)} alone; "
            f"listen there, and come from elsewhere through ssh -L"
        )
