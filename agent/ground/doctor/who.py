"""As whom a fleet is looked at, and what that name has on this computer to show for it."""

from __future__ import annotations

import ssl
from pathlib import Path
from typing import NamedTuple

from agent.core.config import ConfigError, Fleet
from agent.ground.addresses import is_here
from agent.ground.doctor.probe import context
from agent.process.certificates import AUTHORITY, certificate_file, key_file
from agent.process.fleet_certificates import check_pair, parties
from agent.process.robot_keys import keys_folder
from agent.process.transport import LOOKER


class Who(NamedTuple):
    name: str
    trust: ssl.SSLContext | None = None  # what a probe shows and trusts; None: of an open fleet, or without ca.pem
    has_pair: bool = False  # it has a certificate to show
    keys: Path | None = None  # folder of certificates


def who_looks(fleet: Fleet, path: Path, asked: str | None) -> Who:
    """The party that was asked for; else the first console or observer, or a robot that is here, whose certificate lies
    on this computer. Raises ConfigError where the file has no such name."""
    folder = keys_folder(fleet, path)
    if asked is not None and asked not in parties(fleet):
        known = ", ".join(parties(fleet))
        raise ConfigError(f"--as {asked}: no such robot, observer or console; {path} has {known}")
    if not fleet.secured or folder is None:
        return Who(asked or (fleet.access.consoles or (LOOKER,))[0])
    folder = folder.absolute()
    name = asked or _first_with_key(fleet, folder)
    pair = None
    try:
        check_pair(folder, name)
        pair = str(certificate_file(folder, name)), str(key_file(folder, name))
    except ConfigError:
        pass  # said where the files of this computer are looked at
    try:
        trust = context(str(certificate_file(folder, AUTHORITY)), pair)
    except OSError:  # of which an SSLError is one
        trust = None
    return Who(name, trust, pair is not None, folder)


def _first_with_key(fleet: Fleet, folder: Path) -> str:
    here = [robot for robot in fleet.robot if is_here(fleet.robot[robot].listen)]
    names = [*fleet.access.consoles, *fleet.access.observers, *here, LOOKER]
    return next((name for name in names if key_file(folder, name).exists()), names[0])
