"""Where an experiment leaves what it found: result.json, once in a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from agent.config import ConfigError

NAME = "result.json"


def make_room(out: Path) -> None:
    """Make the folder. Raises ConfigError where it holds a result already: none is ever overwritten."""
    if (out / NAME).exists():
        raise ConfigError(f"{out}: holds a {NAME} already; give --out another folder")
    out.mkdir(parents=True, exist_ok=True)


def write_result(out: Path, result: dict[str, Any]) -> None:
    (out / NAME).write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
