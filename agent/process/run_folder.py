"""Where a command writes: a new file, a folder that stays, and one that goes with the run."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from agent.core.config import ConfigError


def run_folder(out: Path | None) -> Path:
    """The folder that was asked for, else runs/<UTC>. Raises ConfigError if it holds anything or cannot be written."""
    folder = new_folder(out or Path("runs") / datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ"))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror}); give --out another folder") from None
    return folder


def new_folder(path: Path) -> Path:
    """The path, where no folder is yet or an empty one. Raises ConfigError for anything else."""
    if path.is_symlink() or path.exists():
        if not path.is_dir():
            raise ConfigError(f"{path}: is there already, and is no folder; give --out a new folder")
        if any(path.iterdir()):
            raise ConfigError(f"{path}: not empty, and nothing is overwritten; give --out a new folder")
    return path


def new_file(path: Path) -> Path:
    """The path, where nothing is yet: no verb overwrites what is on the disk. Raises ConfigError where something is."""
    if path.exists() or path.is_symlink():
        raise ConfigError(f"{path}: is there already, and nothing is overwritten; give --out another name")
    return path


def free_name(path: Path) -> Path:
    """The path, or where something is there already the first of NAME.2.SUFFIX, NAME.3.SUFFIX, ... that is free."""
    number, free = 2, path
    while free.exists() or free.is_symlink():
        free, number = path.with_name(f"{path.stem}.{number}{path.suffix}"), number + 1
    return free


def new_recording(path: Path) -> Path:
    """The path of a recording, where nothing is yet. Raises ConfigError for what would not be found as one again."""
    if path.suffix != ".mcap":
        raise ConfigError(f"{path}: the name of a recording ends in .mcap; give --out such a name")
    return new_file(path)


@contextlib.contextmanager
def temporary_folder() -> Iterator[Path]:
    """A folder with a short path: that of a socket may not be longer than 107 bytes."""
    folder = Path(tempfile.mkdtemp(prefix="aucamp-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
