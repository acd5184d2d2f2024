"""fleet.toml -> Fleet, read and checked. Every mistake is one line: the file, the key, and what to change."""

from __future__ import annotations

import tomllib
from pathlib import Path

import msgspec

from agent.capabilities.swim.landmarks import landmarks_of
from agent.core.config import Behaviour, ConfigError, Fleet, Robot, Struct, Target, convert, explain, read_toml
from agent.robot.fleet_rules import broken_rules


def load_fleet(path: Path) -> Fleet:
    """Read and check a fleet file. Raises ConfigError with one line."""
    fleet = read_fleet(path)
    _check(fleet, path)
    return msgspec.structs.replace(fleet, target={name: _found(t, path.parent) for name, t in fleet.target.items()})


def read_fleet(path: Path) -> Fleet:
    """Read a fleet file, and the file of its tags if it names one; what types cannot say is not asked. Raises
    ConfigError with one line."""
    data = read_toml(path)
    landmarks = data.get("landmarks")
    if not (isinstance(landmarks, dict) and "file" in landmarks):
        return convert(data, Fleet, path)
    fleet = convert({key: value for key, value in data.items() if key != "landmarks"}, Fleet, path)
    return msgspec.structs.replace(fleet, landmarks=landmarks_of(landmarks, path, fleet.tank))


def _found(target: Target, folder: Path) -> Target:
    """Its files, which count from the fleet file's folder, by their full paths: copies of the file lie elsewhere."""
    full = {key: str((folder / name).resolve()) for key in ("picture", "models") if (name := getattr(target, key))}
    return msgspec.structs.replace(target, **full)


def load_robot(fleet: Fleet, name: str, path: Path) -> Robot:
    """The robot called `name`, or ConfigError naming those that exist."""
    if name not in fleet.robot:
        raise ConfigError(f"{path}: no robot '{name}'; the file has {', '.join(fleet.robot)}")
    return fleet.robot[name]


class _Told(Struct, frozen=True, kw_only=True):
    behaviour: Behaviour


def with_behaviour(fleet: Fleet, name: str, text: str) -> Fleet:
    """The fleet, one of whose robots does something else: `text` is what stands behind `behaviour =` in a fleet file,
    such as { kind = "hold" }. Raises ConfigError with one line."""
    try:
        data = tomllib.loads(f"behaviour = {text}")
        told = msgspec.convert(data, _Told).behaviour
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(
            f"""--behaviour {text}: not valid TOML: {error}; write it as in the fleet file: '{{ kind = "hold" }}'"""
        ) from None
    except msgspec.ValidationError as error:
        raise ConfigError(f"--behaviour: {explain(error, data, _Told)}") from None
    told_so = msgspec.structs.replace(fleet.robot[name], behaviour=told)
    fleet = msgspec.structs.replace(fleet, robot={**fleet.robot, name: told_so})
    for key, remedy in broken_rules(fleet):
        raise ConfigError(f"--behaviour: key '{key}': {remedy}")
    return fleet


def _check(fleet: Fleet, path: Path) -> None:
    """What a type cannot say. Raises ConfigError for the first rule that is broken."""
    for key, remedy in broken_rules(fleet):
        raise ConfigError(f"{path}: key '{key}': {remedy}")
