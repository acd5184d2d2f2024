"""`aucamp record`: one fleet into a file, or several, each into a file of its own, by one process."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from threading import Event
from typing import NamedTuple

from agent.ground.at_once import Say, at_once, keys_of, load_fleets, recordings_of
from agent.process.fleet_clock import fleet_clock
from replay.recorder import record


class Recorded(NamedTuple):
    """What came of it, in lines for a person."""

    done: list[str]
    failed: list[str]


def record_fleets(paths: Sequence[Path], out: Path, stop: Event, say: Say, views: bool) -> Recorded:
    """Record until `stop` is set; `say` gets lines meanwhile.

    Of several fleets one that cannot be recorded any longer ends no other's recording. Raises ConfigError for files and
    folders that cannot be used, and where the only fleet cannot be recorded.
    """
    fleets = load_fleets(paths)
    keys = keys_of(fleets, "recorder")
    clocks = {path: fleet_clock(fleet) for path, fleet in fleets.items()}
    files = recordings_of(tuple(fleets.values()), out)
    jobs = {
        fleet.fleet: partial(record, fleet, files[fleet.fleet], stop, clocks[path], views=views, keys=keys[path])
        for path, fleet in fleets.items()
    }
    several = len(jobs) > 1
    say(f"recording fleet{'s' * several} {', '.join(repr(name) for name in jobs)}; Ctrl-C ends it")
    recorded, failed = at_once(jobs, stop, say)
    done = []
    for name, counts in recorded.items():
        if any(counts.values()):
            listed = "recorded: " + ", ".join(f"{kind} {count}" for kind, count in counts.items() if count)
            done.append(f"fleet '{name}': {listed}" if several else listed)
        else:
            failed.append(f"nobody of fleet '{name}' was heard, so {files[name]} was not kept: nothing is in it")
    return Recorded(done, failed)
