"""What a process says of itself to who looks at its links: its name, its version, and digests of what it goes by.

Two that are linked and do not understand each other have different files or versions, and these show which.
"""

from __future__ import annotations

import hashlib
import importlib.metadata
import json

from agent.core.config import Fleet, common
from router_config.access import access_control

OPEN = "none"  # the rules of an open fleet
UNKNOWN = "unknown"  # the version of a tree that is not installed


def metadata(fleet: Fleet, name: str) -> dict[str, str]:
    """Of the process `name`, by this fleet file: what is compared by whoever has another copy of the file."""
    return {
        "fleet": fleet.fleet,
        "name": name,
        "version": version(),
        "file": common(fleet),
        "rules": rules(fleet, name),
    }


def rules(fleet: Fleet, name: str) -> str:
    """Digest of the access rules of `name`: 16 hexadecimal digits of SHA-256."""
    if not fleet.secured:
        return OPEN
    text = json.dumps(access_control(fleet, name), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def version() -> str:
    """Of this package."""
    try:
        return importlib.metadata.version("aucamp")
    except importlib.metadata.PackageNotFoundError:
        return UNKNOWN
