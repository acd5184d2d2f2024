"""Where a running twin keeps its sockets, ports and files, and the rule that one place has one twin."""

from __future__ import annotations

import fcntl
import os
import stat
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from agent.core.config import ConfigError, Fleet

# sockaddr_un holds 108 bytes including the final zero (Linux unix(7)); the longest name is a robot's plus ".camera".
LONGEST_FOLDER = 107 - len("/") - 16 - len(".camera")

RESULTS = ("paths.csv", "separation.json", "creatures.csv", "boxes.csv")  # stay for the evaluation, until the next dive
RUN_FILES = ("*.serial", "*.camera", "*.bench", "*.flash.json", "*.firmware.log", "truth.json", "ready")


def twin_dir(fleet: Fleet) -> Path:
    """The folder of a fleet's twin: `twin.dir` of the fleet file, else one per user and fleet among temporary files.

    Raises ConfigError where somebody else could have put sockets and clock there.
    """
    own = Path(tempfile.gettempdir()) / f"aucamp-{os.getuid()}"
    folder = own / fleet.fleet if fleet.twin.dir is None else Path(fleet.twin.dir)
    _check_owner(folder)
    return folder


def _check_owner(folder: Path) -> None:
    """Raises ConfigError for a folder among temporary files, where anybody may make one of any name, that another user
    made, or can write to; and for such a folder above it."""
    shared = Path(tempfile.gettempdir())
    for one in (folder, *folder.parents):
        if not one.is_relative_to(shared) or one == shared:
            return
        with suppress(OSError):  # it is not there yet
            about = one.lstat()
            if about.st_uid != os.getuid() or not stat.S_ISDIR(about.st_mode):
                raise ConfigError(f"{one}: is no folder that you made; remove it, or set twin.dir to a folder of yours")
            if about.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
                raise ConfigError(f"{one}: others can write to it; remove it, or set twin.dir to a folder of yours")


def clock_path(fleet: Fleet) -> Path:
    """The clock of a fleet's dive. It stays when the twin ends, for agents that outlive it and for the next twin."""
    return twin_dir(fleet) / "clock"


@contextmanager
def locked(folder: Path) -> Iterator[Path]:
    """Hold the folder for one twin: emptied of an earlier run's files at the start, and of this run's but for its
    RESULTS at the end.

    Raises ConfigError when another twin holds it, when it is another user's, or when its path is too long for a socket.
    """
    if len(os.fsencode(folder)) > LONGEST_FOLDER:
        raise ConfigError(
            f"{folder}: path too long for a socket; set twin.dir to one of at most {LONGEST_FOLDER} bytes"
        )
    try:
        for one in reversed((folder, *folder.parents)):
            one.mkdir(mode=0o700, exist_ok=True)
        _check_owner(folder)
        lock = os.open(folder / "lock", os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o600)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be used ({error.strerror}); set twin.dir to a folder of yours") from None
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ConfigError(f"{folder}: another twin runs here; stop it or set twin.dir to another folder") from None
        _remove(folder, (*RUN_FILES, *RESULTS))
        try:
            yield folder
        finally:
            _remove(folder, RUN_FILES)
    finally:
        os.close(lock)  # the file stays: removing a lock file would let two twins lock two different files


def _remove(folder: Path, patterns: Sequence[str]) -> None:
    for pattern in patterns:
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)
