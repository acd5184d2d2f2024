"""A calibration file that is made of parts: one table of it is measured anew, what it said before is kept beside it."""

from __future__ import annotations

import shutil
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import tomli_w

from agent.core.config import ConfigError, read_toml
from agent.process.command import free_name

TABLES = ("focus", "camera")


def check_file(path: Path) -> dict[str, Any]:
    """What the file says now, nothing where it is yet to be made. Raises ConfigError for a file that is no calibration:
    another file of the user's is not to get a table of ours."""
    if path.suffix != ".toml":
        raise ConfigError(f"{path}: give --out a name that ends in .toml")
    if not path.exists():
        return {}
    content = read_toml(path)
    if "robot" not in content or not any(isinstance(content.get(table), dict) for table in TABLES):
        raise ConfigError(f"{path}: is no calibration file; give --out a new name, or that of a calibration")
    return content


def put(path: Path, table: str, fields: dict[str, Any], source: Path) -> str:
    """Write one table of a calibration file and keep its others; says what became of what was there.

    The file as it was is kept beside it, by a name that nothing had. `source`: what was measured.
    """
    before, today = check_file(path), datetime.now(UTC).strftime("%Y-%m-%d")
    content = {"robot": path.stem, "made": today, "source": "", **before}
    content["source"] = "; ".join(filter(None, (content["source"], f"[{table}] on {today} from {source}")))
    content[table] = fields
    path.parent.mkdir(parents=True, exist_ok=True)
    kept = free_name(path.with_name(path.name + ".before"))
    if before:
        shutil.copy2(path, kept)
    fresh = path.with_name(path.name + ".part")
    fresh.write_text(tomli_w.dumps(content), encoding="utf-8")
    fresh.replace(path)
    if not before:
        said = f"[{table}] written to {path}, the calibration of robot '{content['robot']}'"
    else:
        said = f"[{table}] of {path} {'replaced' if table in before else 'added'}; the file as it was: {kept}"
    missing = [each for each in TABLES if each not in content]
    return said + "".join(f"\n[{each}] is missing; a robot needs it: aucamp calibrate {each}" for each in missing)
