"""Which recordings a path stands for, when something is to be made of them, and which robots are in these; and a file
that is made of them, or not at all."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from pathlib import Path

from agent.core.config import ConfigError
from replay.check.black_box import black_boxes, recordings


def recordings_of(path: Path) -> list[Path]:
    """The recordings of a run's folder, or the one that is given. Raises ConfigError for a folder without any."""
    if not path.is_dir():
        return [path]
    found = [*black_boxes(path), *recordings(path, "fleet")]
    if not found:
        raise ConfigError(f"{path}: has no recording (.mcap) in it; give the folder of a run, or a recording")
    return found


def wanted(robot: str | None, there: Iterable[str], path: Path) -> list[str]:
    """The robot that was asked for, or all that are there. Raises ConfigError for one that is not."""
    names = sorted(set(there))
    if robot is None:
        return names
    if robot not in names:
        raise ConfigError(f"{path}: has nothing of a robot '{robot}'; there is {', '.join(names) or 'none'}")
    return [robot]


@contextlib.contextmanager
def whole_or_none(out: Path) -> Iterator[None]:
    """Take away what this block has written to `out` if it breaks off: half a file looks like a whole one."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        out.unlink(missing_ok=True)
        raise
