"""`aucamp page`: what is to be shown, as whom, and what is told to whoever typed it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from threading import Event

from agent.core.config import ConfigError
from agent.ground.console import OrderConsole
from agent.ground.page.live import SHOWN
from agent.ground.page.ordering import give
from agent.ground.page.page import page_of_fleet, page_of_recording
from agent.ground.page.record import Recording
from agent.process.fleet_certificates import credentials
from agent.process.fleet_clock import fleet_clock
from agent.process.transport import LOOKER, Observer
from agent.robot.fleet_reader import load_fleet
from agent.robot.verbs import VERBS
from replay.recorder import record


def run(what: Path, console: str | None, port: int, out: Path, stop: Event, say: Callable[[str], None]) -> None:
    """Until `stop` is set. Raises ConfigError for what cannot be shown, or by this name."""

    def open_it(address: str) -> None:
        say(f"open {address} in a browser on this machine; Ctrl-C ends it")

    if what.is_dir() or what.suffix != ".toml":
        if console is not None:
            raise ConfigError(f"{what}: is a recording, and nobody can be ordered about in it; leave out --as")
        page_of_recording(what, stop, port, open_it)
        return
    fleet = load_fleet(what)
    name = console or LOOKER
    keys = credentials(fleet, name, what)
    clock = fleet_clock(fleet)
    with ExitStack() as stack:
        orders = None
        if console is not None:
            orders = partial(give, stack.enter_context(OrderConsole(fleet, console, keys)))
        recording = Recording(
            lambda file, until: record(fleet, file, until, clock, keys=keys, name=name), out, fleet.fleet
        )
        page_of_fleet(
            fleet,
            Observer(fleet, clock.now_ns, SHOWN, name, keys, once=True),
            stop,
            clock,
            port,
            open_it,
            beside=what.parent,
            console=console,
            give=orders,
            recording=recording,
            verbs=tuple(VERBS),
        )
