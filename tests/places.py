"""Where tests find what is no code: the repository itself, the golden logs, data that others made."""

from __future__ import annotations

import os
from pathlib import Path

from agent.core.config import ConfigError

ROOT = Path(__file__).parents[1]
GOLDEN = ROOT / "tests" / "golden"
DATA = Path(os.environ.get("AUCAMP_DATA", ROOT / ".." / "shared" / "data"))  # absent: what needs it is skipped


def shared(*parts: str) -> Path:
    """A folder of DATA. Raises ConfigError where it is absent."""
    folder = DATA.joinpath(*parts)
    if not folder.is_dir():
        raise ConfigError(f"{folder}: no such folder; it takes the shared data, or AUCAMP_DATA=DIR that holds them")
    return folder
