"""All that one robot needs to sign and to believe, from the folder that its fleet file names, read before it dives."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from agent.core.config import ConfigError, Fleet
from agent.process.key_files import UnusableKeyError, private_file, public_bytes, public_file, read_private
from agent.process.key_folder import KeyFolder, read_keys
from agent.process.signing import Sign, signing, unsigned

VARIABLE = "AUCAMP_KEYS"  # names the folder of keys on this computer; goes before the fleet file's


class RobotKeys(NamedTuple):
    """What signs for a robot, and the public keys of all."""

    sign: Sign
    changed: Callable[[int], dict[str, bytes] | None]  # now_ns -> KeyFolder.changed
    fault: Callable[[], str | None]  # what to mend in the folder


NO_KEYS = RobotKeys(unsigned, lambda now_ns: None, lambda: None)  # of a fleet that signs nothing


def robot_keys(fleet: Fleet, robot: str, fleet_path: Path) -> RobotKeys:
    """The keys of this robot, or NO_KEYS. Raises ConfigError, one line, for a file that cannot be used.

    A public key of another robot may be missing: until it is there, nothing of that robot is believed.
    """
    folder = keys_folder(fleet, fleet_path)
    if folder is None:
        return NO_KEYS
    path = private_file(folder, robot)
    if not path.exists():
        raise ConfigError(
            f"{path}: no such file; copy it from where the keys were made, or make it with: "
            f"aucamp keys {fleet_path} --out {folder} --only {robot}"
        )
    try:
        private = read_private(path)
    except UnusableKeyError as error:
        raise ConfigError(f"{path}: {error}") from None
    found = read_keys(folder, fleet.robot)
    for name, why in found.unusable.items():
        raise ConfigError(f"{public_file(folder, name)}: {why}")
    own = public_file(folder, robot)
    if robot in found.missing:
        raise ConfigError(f"{own}: no such file; copy it from where {path.name} was made")
    if found.keys[robot] != public_bytes(private.public_key()):
        raise ConfigError(f"{own}: not the public half of {path.name}; copy both files of one pair")
    watched = KeyFolder(folder, tuple(fleet.robot))
    return RobotKeys(signing(robot, private), watched.changed, lambda: watched.fault)


def keys_folder(fleet: Fleet, fleet_path: Path) -> Path | None:
    """Where this computer has the keys; None: the fleet file names none, so nothing is signed."""
    if fleet.access.keys is None:
        return None
    here = os.environ.get(VARIABLE)
    return Path(here) if here else fleet_path.parent / fleet.access.keys
