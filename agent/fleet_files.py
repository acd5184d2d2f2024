"""Fleet files that come with the package, found by name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from agent.kernel.config import ConfigError


def shipped_fleet(name: str = "tank") -> Path:
    """A fleet file that comes with the package."""
    return Path(str(resources.files("agent") / "fleets" / f"{name}.toml"))


def fleet_file(name: str) -> Path:
    """The path of a TOML file, or the name of a fleet that comes with the package. Raises ConfigError for neither."""
    if name.endswith(".toml"):
        return Path(name)
    shipped = shipped_fleet(name)
    if not shipped.exists():
        names = ", ".join(sorted(path.stem for path in shipped.parent.glob("*.toml")))
        raise ConfigError(f"--fleet {name}: no such fleet; give one of {names}, or the path of a .toml file")
    return shipped
