"""Where a command writes: a new file, a folder that stays, and one that goes with the run."""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from agent.kernel.config import ConfigError


def run_folder(out: Path | None) -> Path:
    """The folder that was asked for, else runs/<UTC>. Raises ConfigError if it holds anything or cannot be written."""
    folder = out or Path("runs") / datetime.now(UTC).strftime("%Y%m%dT%H%M%SZ")
    if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise ConfigError(f"{folder}: not empty; give --out a new folder, recordings are never overwritten")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / ".writable").touch()
        (folder / ".writable").unlink()
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be written ({error.strerror}); give --out another folder") from None
    return folder


def new_file(path: Path) -> Path:
    """The path, where nothing is yet: no verb overwrites what is on the disk. Raises ConfigError where something is."""
    if path.exists() or path.is_symlink():
        raise ConfigError(f"{path}: is there already, and nothing is overwritten; give --out another name")
    return path


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
