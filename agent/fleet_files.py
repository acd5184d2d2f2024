"""Fleet files that come with the package, found by name."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

from agent.kernel.config import ConfigError

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
