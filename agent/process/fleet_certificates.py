"""The certificates of a whole fleet: who gets one, what is in it, and what each process needs of them to start."""

from __future__ import annotations

import json
import stat
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from agent.core.config import ConfigError, Fleet
from agent.process.certificates import (
    AUTHORITY,
    Pair,
    certificate_file,
    common_name,
    issue,
    key_file,
    make_ca,
    read,
    write,
)
from agent.process.key_files import EVERYBODY, write_new
from agent.process.robot_keys import keys_folder
from router_config.session import ROUTER, tls

CONSOLE_FILE = "zenoh-cli.json5"  # for the program `zenoh`, on the computer where it was made
CONSOLE_NAME = "view"  # as whom it looks; else the first observer


def parties(fleet: Fleet) -> list[str]:
    """All who have a certificate: robots, observers, consoles."""
    return [*fleet.robot, *fleet.access.observers, *fleet.access.consoles]


def hosts(fleet: Fleet, name: str) -> tuple[str, ...]:
    """Where a party may be dialled; nobody dials an observer or a console, but for the router on its own computer."""
    if name in fleet.robot:
        return (fleet.robot[name].listen.partition("/")[2].rpartition(":")[0].strip("[]"),)
    return ("127.0.0.1", "localhost") if name == ROUTER else ()


def write_certificates(fleet: Fleet, folder: Path, names: Sequence[str], days: float, ca: Pair) -> list[Path]:
    """A pair for each name, by this authority; returns the files."""
    ends = datetime.now(UTC) + timedelta(days=days)
    made: list[Path] = []
    for name in names:
        made += write(folder, name, issue(ca, name, hosts(fleet, name), ends=ends))
    return made


def new_authority(fleet: Fleet, folder: Path) -> tuple[Pair, list[Path]]:
    """A new authority, and its files. Never a second one in the same folder: ConfigError."""
    ca = make_ca(fleet.fleet)
    return ca, list(write(folder, AUTHORITY, ca))


def authority(folder: Path) -> Pair:
    """The authority whose files lie there. Raises ConfigError, one line, where they do not."""
    if not key_file(folder, AUTHORITY).exists():
        raise ConfigError(
            f"{key_file(folder, AUTHORITY)}: no such file; give --out the folder in which the fleet's keys were made"
        )
    return read(folder, AUTHORITY)


def write_console_file(fleet: Fleet, folder: Path) -> list[Path]:
    """What the program `zenoh` needs to look at the fleet as an observer; none where the fleet has no observer."""
    observers = fleet.access.observers
    if not observers:
        return []
    name = CONSOLE_NAME if CONSOLE_NAME in observers else observers[0]
    path = folder / CONSOLE_FILE
    config = {"transport": {"link": {"tls": tls(folder.resolve(), name)}}}
    write_new(path, (json.dumps(config, indent=2) + "\n").encode(), EVERYBODY)
    return [path]


def credentials(fleet: Fleet, name: str, fleet_path: Path) -> Path | None:
    """The full path of the folder with the certificates of a secured fleet, once `name` has been seen to have what it
    needs there; None of an open one. Raises ConfigError, one line that says what to mend."""
    if not fleet.secured:
        return None
    folder = keys_folder(fleet, fleet_path)
    if folder is None:  # which fleet_rules turn down
        raise ConfigError(f"{fleet_path}: key 'access.keys': robots listen on tls/; name the folder of certificates")
    folder = folder.absolute()
    if name not in parties(fleet):
        raise ConfigError(
            f"{fleet_path}: key 'access.observers': has no '{name}'; add it, and make its certificate with: "
            f"aucamp keys {fleet_path} --out DIR --only {name}"
        )
    if not certificate_file(folder, AUTHORITY).exists():
        raise ConfigError(f"{certificate_file(folder, AUTHORITY)}: no such file; copy it from where the keys were made")
    check_pair(folder, name)
    return folder


def check_pair(folder: Path, name: str) -> Pair:
    """A party's own pair, as it can be used. Raises ConfigError, one line that says what to mend."""
    path, pair = key_file(folder, name), read(folder, name)
    mode = stat.S_IMODE(path.stat().st_mode)
    if mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise ConfigError(f"{path}: others may read this private key (mode {mode:04o}); run: chmod 600 {path}")
    if (said := common_name(pair.certificate)) != name:
        raise ConfigError(f"{certificate_file(folder, name)}: is of '{said}', not of {name}; copy {name}'s own")
    return pair
