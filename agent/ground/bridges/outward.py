"""From a fleet into somebody else's network of Zenoh, and never back.

That network is a second session, by their router on this machine. It knows no rules of ours: whoever reaches it could
say anything, so nothing is heard there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import ExitStack
from pathlib import Path
from threading import Event
from typing import NamedTuple, Protocol

from agent.clock import machine
from agent.core.config import Fleet
from agent.core.messages import Message
from agent.core.topics import Topic
from agent.ground.bridges.hearing import own_word
from agent.process.fleet_certificates import credentials
from agent.process.fleet_clock import fleet_clock
from agent.process.transport import LOOKER, Observer
from router_config.door import Session
from router_config.session import client_config

PERIOD_S = 0.02  # between two looks at what robots have said


class Foreign(NamedTuple):
    """A message of theirs."""

    key: str
    payload: bytes
    attachment: bytes = b""


class Language(Protocol):
    """Pure: what it is given decides what it says."""

    rows: tuple[Topic, ...]  # of ours, which it has words for

    def tokens(self, session: str) -> Iterable[str]:
        """What is announced, by the id of the session over there. Called before all else."""

    def said(self, message: Message, now_ns: int) -> Iterable[Foreign]:
        """What a robot has said, in that language; `now_ns`: since the Unix epoch."""


def run(
    fleet: Fleet,
    fleet_path: Path,
    name: str | None,
    port: int,
    language: Language,
    stop: Event,
    say: Callable[[str], None],
) -> None:
    """Until `stop` is set. Raises ConfigError where this name may not look, or no router is there."""
    keys, clock = credentials(fleet, name or LOOKER, fleet_path), fleet_clock(fleet)
    router = f"tcp/127.0.0.1:{port}"
    with ExitStack() as stack:
        session = stack.enter_context(Session(client_config(router), f"no router at {router}, or it turns us away"))
        for token in language.tokens(session.id):
            session.announce(token)
        observer = stack.enter_context(Observer(fleet, clock.now_ns, language.rows, name or LOOKER, keys, once=True))
        say(f"to the router at {router}: {', '.join(fleet.robot)}; Ctrl-C ends it")
        while not machine.wait(stop, PERIOD_S):
            for received in observer.drain():
                if (message := own_word(received)) is not None:
                    for theirs in language.said(message, machine.unix_ns()):
                        session.put_foreign(*theirs)
