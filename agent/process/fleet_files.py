"""Fleet files that come with the package, found by name; and what goes with a file into another folder."""

from __future__ import annotations

import shutil
from importlib import resources
from pathlib import Path

import msgspec

from agent.core.config import ConfigError, Fleet

FLEETS = Path(str(resources.files("agent") / "fleets"))


def shipped_fleet(name: str = "tank") -> Path:
    """A fleet file that comes with the package."""
    return FLEETS / f"{name}.toml"


def shipped_names() -> list[str]:
    """The fleets that come with the package, by name."""
    return sorted(path.stem for path in FLEETS.glob("*.toml"))


def fleet_file(name: str) -> Path:
    """The path of a TOML file, or the name of a fleet that comes with the package. Raises ConfigError for neither."""
    if name.endswith(".toml"):
        return Path(name)
    if name not in shipped_names():
        raise ConfigError(
            f"--fleet {name}: no such fleet; give one of {', '.join(shipped_names())}, or the path of a .toml file"
        )
    return shipped_fleet(name)


def with_pictures(fleet: Fleet, folder: Path) -> Fleet:
    """The fleet as a file in this folder says it, once its targets' pictures have been copied there.

    A run's folder is given to others, who do not have what lay beside the file that it was made from.
    """
    targets = {}
    for name, target in fleet.target.items():
        if target.picture is not None:
            own = f"{name}{Path(target.picture).suffix}"
            shutil.copyfile(target.picture, folder / own)
            target = msgspec.structs.replace(target, picture=own)
        targets[name] = target
    return msgspec.structs.replace(fleet, target=targets)
