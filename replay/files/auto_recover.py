"""Recordings whose writer was killed are mended without being asked: by who starts again, and by who opens them.

A robot that starts has better things to do than to read half a gigabyte, so that is left to a process of its own, at
low priority. What cannot be mended is said, and nothing else happens.
"""

from __future__ import annotations

import logging
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from threading import Event, Thread

from agent.clock import machine
from replay.files.file_lock import is_held
from replay.files.names import SUFFIX, parts, recovered
from replay.files.recover import sound

logger = logging.getLogger(__name__)

PAUSE_S = 3.0  # who has just started needs the machine for itself

Say = Callable[[str], None]


def auto_recovered(paths: Iterable[Path], say: Say) -> list[Path]:
    """What to open for each of some folders and files, after their torn files were mended; a line for each of those.

    In a folder, and for later parts, the mended copy stands in for the torn file by its name.
    """
    found = []
    for path in paths:
        if path.is_dir():
            for file in sorted(path.glob(f"*.mcap{SUFFIX}")):
                sound(file, say)
            found.append(path)
        else:
            first, *later = parts(path)
            for file in later:
                sound(file, say)
            found.append(sound(first, say))
    return found


def torn_files(path: Path) -> list[Path]:
    """Torn files of the recording `path`, of its parts and of earlier starts, that nobody has mended yet."""
    name = re.compile(re.escape(path.name.removesuffix(".mcap")) + r"(\.\d+)?(\.part\d{3,})?\.mcap" + re.escape(SUFFIX))
    if not path.parent.is_dir():
        return []
    torn = sorted(file for file in path.parent.iterdir() if name.fullmatch(file.name))
    return [file for file in torn if not recovered(file).exists() and not is_held(file)]


@contextmanager
def recovering(files: Sequence[Path], say: Say = logger.warning, pause_s: float = PAUSE_S) -> Iterator[None]:
    """Mend these files meanwhile, in a process that gives way to all others; `say` gets a line for each.

    Not before `pause_s` have passed. What is not done at the end is left to the next start.
    """
    stop = Event()
    worker = Thread(target=_mend, args=(files, say, pause_s, stop), name="recovering", daemon=True)
    if files:
        worker.start()
    try:
        yield
    finally:
        stop.set()
        if files:
            worker.join()


def _mend(files: Sequence[Path], say: Say, pause_s: float, stop: Event) -> None:
    gentle = ["nice", "-n", "19"] if shutil.which("nice") else []
    machine.wait(stop, pause_s)
    for file in files:
        if stop.is_set():
            return
        command = [*gentle, sys.executable, "-m", "agent", "replay", "recover", str(file)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
            while process.poll() is None:
                if machine.wait(stop, 0.1):
                    process.terminate()
                    break
            said = process.communicate()[0].strip()
        if said:
            say(said.splitlines()[-1])
