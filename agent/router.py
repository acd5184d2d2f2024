"""The router: a place to look from. The swarm runs without it, and no link of the swarm passes through it."""

from __future__ import annotations

import threading

from agent.config import Fleet
from agent.session import ROUTER_LISTEN, router_config
from agent.transport import open_session


def run_router(fleet: Fleet, stop: threading.Event, listen: str = ROUTER_LISTEN) -> None:
    """Dial every robot and serve clients on `listen` until `stop` is set. Raises ConfigError if it cannot listen."""
    with open_session(router_config(fleet, listen), f"router: {listen}"):
        stop.wait()
