"""The router: a place to look from. The swarm runs without it, and no link of the swarm passes through it."""

from __future__ import annotations

import threading
from collections.abc import Callable

from agent.kernel.config import Fleet
from router_config.door import Session
from router_config.session import ROUTER_LISTEN, router_config


def run_router(
    fleet: Fleet, stop: threading.Event, listen: str = ROUTER_LISTEN, say: Callable[[str], None] = lambda line: None
) -> None:
    """Dial every robot and serve clients on `listen` until `stop` is set; `say` gets one line: where to look.

    Raises ConfigError if it cannot listen.
    """
    with Session(router_config(fleet, listen), f"router: {listen}"):
        say(f"consoles attach to {listen}; Ctrl-C ends it")
        stop.wait()
