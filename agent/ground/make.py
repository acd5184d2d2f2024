"""`aucamp keys`: signing keys, and certificates of a secured fleet; and in words what goes where."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

from agent.core.config import ConfigError, Fleet
from agent.ground.where_to import where_to
from agent.process.certificates import AUTHORITY, LEAF_DAYS, certificate_file, key_file
from agent.process.fleet_certificates import (
    CONSOLE_FILE,
    authority,
    new_authority,
    parties,
    write_certificates,
    write_console_file,
)
from agent.process.key_files import private_file, public_file, write_pair
from agent.robot.fleet_reader import load_robot

FOLDER = "keys"  # beside the fleet file, where nothing else is said

EXISTS = (
    "exists, and keys are never overwritten; give --out a new folder, take --only for one that has none yet, or remove "
    "both files of a pair that is to be replaced"
)


def make_keys(robots: Iterable[str], folder: Path) -> list[Path]:
    """A signing pair for each of these robots; returns the files. Raises ConfigError before anything is written where
    one of them exists.
    """
    robots = list(robots)
    _refuse_any(path for name in robots for path in _signing(folder, name))
    return _all_or_nothing(folder, [partial(write_pair, folder, name) for name in robots])


def make_all(fleet: Fleet, folder: Path, days: float = LEAF_DAYS) -> list[Path]:
    """Signing keys of the robots, and in a secured fleet an authority and everybody's certificate. Raises ConfigError
    before anything is written where one of the files exists."""
    if not fleet.secured:
        return make_keys(fleet.robot, folder)
    names = parties(fleet)
    _refuse_any(path for name in fleet.robot for path in _signing(folder, name))
    _refuse_any(path for name in (AUTHORITY, *names) for path in _certificate(folder, name))
    _refuse_any([folder / CONSOLE_FILE])

    def certificates() -> list[Path]:
        ca, made = new_authority(fleet, folder)
        return [*made, *write_certificates(fleet, folder, names, days, ca), *write_console_file(fleet, folder)]

    return _all_or_nothing(folder, [*(partial(write_pair, folder, name) for name in fleet.robot), certificates])


def make_one(fleet: Fleet, folder: Path, name: str, path: Path, days: float = LEAF_DAYS) -> list[Path]:
    """What this party lacks: its signing pair, if it is a robot, and its certificate by the authority in the folder."""
    if not fleet.secured or name not in parties(fleet):
        load_robot(fleet, name, path)
    makers: list[Callable[[], Iterable[Path]]] = []
    if name in fleet.robot and not any(file.exists() for file in _signing(folder, name)):
        makers.append(partial(write_pair, folder, name))
    if fleet.secured and not any(file.exists() for file in _certificate(folder, name)):
        makers.append(partial(write_certificates, fleet, folder, [name], days, authority(folder)))
    if not makers:
        _refuse_any((*_certificate(folder, name), *_signing(folder, name)))
    return _all_or_nothing(folder, makers)


def fleet_keys(fleet: Fleet, path: Path, out: Path, only: str | None = None, days: float = LEAF_DAYS) -> list[str]:
    """Make the keys of a fleet, or of one party of it; returns lines that say what to do with them."""
    made = make_all(fleet, out, days) if only is None else make_one(fleet, out, only, path, days)
    beside = out.resolve().parent == path.resolve().parent
    named = fleet.access.keys or (out.resolve().name if beside else FOLDER)
    lines = where_to(fleet, made, named)
    if fleet.access.keys is None:
        lines += ["", f"Every copy of {path.name} has to say so:", "", "[access]", f'keys = "{named}"']
    return lines


def _signing(folder: Path, name: str) -> tuple[Path, Path]:
    return private_file(folder, name), public_file(folder, name)


def _certificate(folder: Path, name: str) -> tuple[Path, Path]:
    return certificate_file(folder, name), key_file(folder, name)


def _refuse_any(paths: Iterable[Path]) -> None:
    for path in paths:
        if path.exists():
            raise ConfigError(f"{path}: {EXISTS}")


def _all_or_nothing(folder: Path, makers: Sequence[Callable[[], Iterable[Path]]]) -> list[Path]:
    """The files that all of these made; a part of a fleet's keys would be in the way of the next attempt."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made ({error.strerror}); give --out another folder") from None
    before = set(folder.iterdir())
    try:
        return [path for make in makers for path in make()]
    except BaseException:
        for path in set(folder.iterdir()) - before:
            path.unlink()
        raise
