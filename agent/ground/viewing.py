"""`aucamp view`: one fleet in Foxglove, or several, each at a port of its own, by one process."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from threading import Event

from agent.ground.at_once import Say, at_once, keys_of, load_fleets
from agent.process.failure import Failed
from agent.process.fleet_clock import fleet_clock
from replay.view import view


def view_fleets(paths: Sequence[Path], port: int, stop: Event, say: Say) -> None:
    """Serve until `stop` is set, the first fleet at `port`, the next at the next; `say` gets lines for a person.

    Of several fleets one that cannot be served ends no other's view; at the end Failed is raised. Raises ConfigError
    for files that cannot be used, and where the only fleet cannot be served.
    """
    fleets = load_fleets(paths)
    keys = keys_of(fleets, "view")
    jobs = {
        fleet.fleet: partial(view, fleet, stop, fleet_clock(fleet), at, keys=keys[path])
        for at, (path, fleet) in enumerate(fleets.items(), start=port)
    }
    _, failed = at_once(jobs, stop, say)
    if failed:
        raise Failed("; ".join(failed))
