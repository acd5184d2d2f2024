"""Several fleets looked at by one process: a thread for each, so that what happens to one stops none of the others."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import TypeVar

from agent.core.config import ConfigError, Fleet
from agent.process.fleet_certificates import credentials
from agent.process.robot_keys import VARIABLE
from agent.process.run_folder import new_recording
from agent.robot.fleet_reader import load_fleet

T = TypeVar("T")
Say = Callable[[str], None]  # a line for a person


def load_fleets(paths: Sequence[Path]) -> dict[Path, Fleet]:
    """All these fleets. Raises ConfigError for a file that is no fleet's, and for two fleets of one name."""
    fleets: dict[Path, Fleet] = {}
    for path in paths:
        fleet = load_fleet(path)
        if (same := next((other for other, known in fleets.items() if known.fleet == fleet.fleet), None)) is not None:
            raise ConfigError(
                f"{path}: fleet '{fleet.fleet}', as {same} is; give each fleet a name of its own (key 'fleet'), or "
                f"look at them by two commands"
            )
        fleets[path] = fleet
    return fleets


def keys_of(fleets: Mapping[Path, Fleet], name: str) -> dict[Path, Path | None]:
    """The folder of each secured fleet's certificates, in which `name` has one. Raises ConfigError.

    The variable AUCAMP_KEYS names one folder, and each fleet has an authority of its own.
    """
    if len(fleets) > 1 and VARIABLE in os.environ and any(fleet.secured for fleet in fleets.values()):
        raise ConfigError(f"{VARIABLE} names the keys of one fleet; unset it: each fleet file says where its own are")
    return {path: credentials(fleet, name, path) for path, fleet in fleets.items()}


def recordings_of(fleets: Sequence[Fleet], out: Path) -> dict[str, Path]:
    """Where each fleet is recorded, by its name: a file, or of several a file each in a folder.

    Raises ConfigError where something is there already.
    """
    if len(fleets) == 1:
        return {fleets[0].fleet: new_recording(out)}
    if out.suffix == ".mcap":
        raise ConfigError(f"--out {out}: each of several fleets has a recording of its own; give --out a folder")
    files = {fleet.fleet: new_recording(out / f"{fleet.fleet}.mcap") for fleet in fleets}
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be made ({error.strerror}); give --out another folder") from None
    return files


def at_once(jobs: Mapping[str, Callable[[Say], T]], stop: Event, say: Say) -> tuple[dict[str, T], list[str]]:
    """Do all of this until each has ended, which `stop` tells them to; returns by fleet what came of it, and lines
    about those that could not go on.

    Each job is given a `say` for its lines, which names its fleet. One that raises ConfigError has ended: that is said
    at once, and the others go on. Whatever else a job raises ends all of them. A job alone is simply done: its lines
    name no fleet, and what it raises is raised.
    """
    if len(jobs) == 1:
        return {name: job(say) for name, job in jobs.items()}, []
    done: dict[str, T] = {}
    failed: list[str] = []

    def do(name: str, job: Callable[[Say], T]) -> None:
        def of_fleet(line: str) -> None:
            say(f"fleet '{name}': {line}")

        try:
            done[name] = job(of_fleet)
        except ConfigError as error:
            failed.append(f"fleet '{name}': {error}")
            say(failed[-1])
        except BaseException:
            stop.set()
            raise

    with ThreadPoolExecutor(len(jobs)) as pool:
        for running in [pool.submit(do, name, job) for name, job in jobs.items()]:
            running.result()
    return {name: done[name] for name in jobs if name in done}, failed
