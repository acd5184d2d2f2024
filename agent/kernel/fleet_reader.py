"""fleet.toml -> Fleet, read and checked. Every mistake is one line: the file, the key, and what to change."""

from __future__ import annotations

from pathlib import Path

import msgspec

from agent.kernel.config import ConfigError, Fleet, Robot, Target
from agent.kernel.fleet_rules import broken_rules
from agent.kernel.toml_files import convert, read_toml


def load_fleet(path: Path) -> Fleet:
    """Read and check a fleet file. Raises ConfigError with one line."""
    fleet = convert(read_toml(path), Fleet, path)
    _check(fleet, path)
    return msgspec.structs.replace(fleet, target={name: _found(t, path.parent) for name, t in fleet.target.items()})


def _found(target: Target, folder: Path) -> Target:
    """Its files, which count from the fleet file's folder, by their full paths: copies of the file lie elsewhere."""
    full = {key: str((folder / name).resolve()) for key in ("picture", "models") if (name := getattr(target, key))}
    return msgspec.structs.replace(target, **full)


def load_robot(fleet: Fleet, name: str, path: Path) -> Robot:
    """The robot called `name`, or ConfigError naming those that exist."""
    if name not in fleet.robot:
        raise ConfigError(f"{path}: no robot '{name}'; the file has {', '.join(fleet.robot)}")
    return fleet.robot[name]


def _check(fleet: Fleet, path: Path) -> None:
    """What a type cannot say. Raises ConfigError for the first rule that is broken."""
    for key, remedy in broken_rules(fleet):
        raise ConfigError(f"{path}: key '{key}': {remedy}")
