"""With what a recording was made: machine and versions, the first suspects when a replay differs."""

from __future__ import annotations

import importlib.metadata
import platform

PACKAGES = ("aucamp", "eclipse-zenoh", "numpy", "opencv-python-headless", "numba", "msgpack", "msgspec", "mcap")


def environment() -> dict[str, str]:
    """Entries for the metadata `aucamp.run`."""
    return {
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}",
        **{f"version.{package}": version(package) for package in PACKAGES},
    }


def version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"
