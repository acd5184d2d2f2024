"""Who is writing a file: its writer holds a lock on it, which the operating system takes back when the writer dies.

So a file with the name of an unfinished one and without a lock is one whose writer was killed, however short ago. Where
a file system has no locks, nobody seems to be writing.
"""

from __future__ import annotations

import contextlib
import fcntl
from pathlib import Path
from typing import IO


def hold(file: IO[bytes]) -> None:
    """Mark an open file as being written, until it is closed."""
    with contextlib.suppress(OSError):
        fcntl.flock(file, fcntl.LOCK_EX)


def is_held(path: Path) -> bool:
    """Whether a writer is at work on this file."""
    try:
        with path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:  # not there, not ours to read, or no locks
        return False
    return False
