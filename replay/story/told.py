"""`aucamp replay info`: the story of each recording, then what is in its files."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from agent.core.config import ConfigError
from replay.files.info import Info, as_json, describe, info
from replay.files.names import parts
from replay.files.suspect import suspecting
from replay.story.facts import story_facts
from replay.story.words import story

WIDTH = 100  # characters of a line


def info_all(paths: Iterable[Path], json_: bool, say: Callable[[str], None]) -> None:
    """Each file of each recording, later parts included; the story stands with the first. Raises as `info` does.

    A folder stands for the recordings in it. Raises ConfigError for one that has none.
    """
    for path in _recordings(paths):
        facts: dict[str, Any] | None = None
        for number, file in enumerate(parts(path)):
            with suspecting(file):
                about = info(file)
                if number == 0:
                    facts = _facts(path, about)
                told = facts if number == 0 else None
                say(_for_programs(file, about, told) if json_ else _for_people(file, about, told))


def _recordings(paths: Iterable[Path]) -> list[Path]:
    found = []
    for path in paths:
        there = sorted(path.glob("*.mcap")) + sorted(path.glob("*.mcap.active")) if path.is_dir() else [path]
        if not there:
            raise ConfigError(f"{path}: has no recording (.mcap) in it; give the folder of a run, or a recording")
        found += [file for file in there if len(there) == 1 or ".part" not in file.name]
    return found


def _facts(path: Path, about: Info) -> dict[str, Any] | None:
    """None of a file that is no recording of ours, or whose header cannot be believed: `describe` says so."""
    return story_facts(path) if about.run.get("kind") in ("black box", "fleet") and not about.damage else None


def _for_people(file: Path, about: Info, facts: dict[str, Any] | None) -> str:
    head, _, rest = describe(file, about).partition("\n")
    if facts is None:
        return f"{head}\n{rest}"
    paragraph = textwrap.fill(story(facts, about), WIDTH, initial_indent="  ", subsequent_indent="  ")
    return f"{head}\n{paragraph}\n\n{rest}"


def _for_programs(file: Path, about: Info, facts: dict[str, Any] | None) -> str:
    return json.dumps({**json.loads(as_json(file, about)), "story": facts}, indent=1)
