"""`aucamp bridge mavlink`: the socket to one ground station on this machine, and the threads in which orders wait.

MAVLink as it is used has no keys: who holds the port is believed. So it is a port of this machine, and a datagram from
any other does not reach us.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from threading import Event
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from agent.clock import machine
from agent.core.config import Fleet
from agent.core.messages import LogLine, State
from agent.core.topics import LOG, STATE
from agent.ground.bridges.hearing import own_word
from agent.ground.bridges.mavlink.gateway import MOST_UNDER_WAY, Done, Gateway, Give
from agent.ground.bridges.mavlink.telling import Origin
from agent.ground.console import OrderConsole, Outcome
from agent.process.fleet_certificates import credentials
from agent.process.fleet_clock import fleet_clock
from agent.process.transport import LOOKER, Observer

HOST = "127.0.0.1"
PERIOD_S = 0.02  # between two looks at what robots have said
DATAGRAM = 2**16  # bytes


def run(
    fleet: Fleet,
    fleet_path: Path,
    console: str | None,
    port: int,
    origin: Origin,
    stop: Event,
    say: Callable[[str], None],
) -> None:
    """Until `stop` is set. Raises ConfigError where this name may not look, or not order."""
    name = console or LOOKER
    keys, clock = credentials(fleet, name, fleet_path), fleet_clock(fleet)
    with ExitStack() as stack:
        give = None
        if console is not None:
            give = stack.enter_context(_ordering(stack.enter_context(OrderConsole(fleet, console, keys))))
        link = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        link.connect((HOST, port))
        link.settimeout(PERIOD_S)

        def send(data: bytes) -> None:
            with suppress(OSError):  # no ground station is there yet
                link.send(data)

        gateway = Gateway(fleet, origin, send, give)
        observer = stack.enter_context(Observer(fleet, clock.now_ns, (STATE, LOG), name, keys))
        systems = ", ".join(f"{robot} is system {number}" for robot, number in gateway.systems.items())
        say(f"to udp://{HOST}:{port}, where a ground station of this machine listens: {systems}; Ctrl-C ends it")
        reader = mavlink.MAVLink(None)
        reader.robust_parsing = True
        while not stop.is_set():
            for message in _arrived(link, reader, stop):
                gateway.heard(message, clock.now_ns(), machine.monotonic_ns())
            for received in observer.drain():
                if isinstance(shown := own_word(received), State | LogLine):
                    gateway.shown(shown, received.arrived_ns, machine.monotonic_ns())
            gateway.tick(clock.now_ns(), machine.monotonic_ns())


def _arrived(link: socket.socket, reader: Any, stop: Event) -> list[Any]:
    """What the ground station has said within a period."""
    try:
        data = link.recv(DATAGRAM)
    except TimeoutError:
        return []
    except OSError:  # nobody listens there: the system has told the last datagram's sender
        machine.wait(stop, PERIOD_S)
        return []
    return reader.parse_buffer(data) or []


@contextmanager
def _ordering(console: OrderConsole) -> Iterator[Give]:
    """Orders, each in a thread, since they wait for their answer."""
    with ThreadPoolExecutor(MOST_UNDER_WAY) as threads:

        def give(robot: str, verb: str, done: Done) -> None:
            def over(future: Future[Outcome]) -> None:
                error = future.exception()
                done(Outcome(None, f"could not be given: {error}") if error else future.result())

            threads.submit(lambda: console.order([robot], verb)[robot]).add_done_callback(over)

        yield give
