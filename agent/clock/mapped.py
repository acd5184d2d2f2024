"""The file in which a dive's clock stands, mapped by every process of the dive: numbers of 64 bits, nothing else.

The twin writes the head: a line, by which run time follows from the machine's monotonic clock, and the horizon, which
it must not cross. Each part that takes part writes a row: how far it has come. A number is written whole, the head
between two changes of its sequence number. Whoever writes holds a lock on one byte, the twin on the first, a process
on that of its row, and the kernel takes it away from the dead: nobody has to be asked whether he lives.
"""

from __future__ import annotations

import fcntl
import mmap
import os
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

MAGIC = int.from_bytes(b"AUCLOCK1", "little")
HEAD, ROW = 16, 8  # numbers in the head, in a row
NAME_WORD, NAME_BYTES = 4, 32
MAGIC_WORD, SEQUENCE, BASE, WALL, RATE, HORIZON, ROWS, START, ACHIEVED = range(9)  # of the head
ACTIVE, REACHED, SLACK = range(3)  # of a row
PPM = 1_000_000

_LOCK = struct.Struct("hhqqi4x")  # struct flock of 64-bit Linux: type, whence, start, length, process


class Line(NamedTuple):
    """Run time as a function of the wall's: base_ns + rate * (monotonic - wall_ns), at most horizon_ns."""

    base_ns: int
    wall_ns: int
    rate: float
    horizon_ns: int
    achieved: float = 1.0  # the rate of late, standing still included

    def at(self, monotonic_ns: int) -> int:
        """Run time if nothing held it."""
        return self.base_ns + round(self.rate * (monotonic_ns - self.wall_ns))

    def left_at(self, monotonic_ns: int) -> int:
        """Run time at the wall's pace, once nobody drives it any more."""
        return self.base_ns + monotonic_ns - self.wall_ns


class Row(NamedTuple):
    """How far a part has come, and how much further the clock may go."""

    active: bool
    reached_ns: int
    slack_ns: int


class ClockFile:
    """One mapping of the file. `words` is shared with every process that maps it."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._map = mmap.mmap(fd, 0)
        self.words = memoryview(self._map).cast("q")
        count = self.words[ROWS]
        names = (bytes(self._map[8 * (HEAD + ROW * i + NAME_WORD) :][:NAME_BYTES]) for i in range(count))
        self.rows = {name.rstrip(b"\0").decode(): i for i, name in enumerate(names)}

    def close(self) -> None:
        self.words.release()
        self._map.close()
        os.close(self.fd)

    def line(self) -> Line:
        words = self.words
        while True:
            before = words[SEQUENCE]
            line = Line(words[BASE], words[WALL], words[RATE] / PPM, words[HORIZON], words[ACHIEVED] / PPM)
            if before == words[SEQUENCE] and not before & 1:
                return line

    def publish(self, line: Line) -> None:
        words = self.words
        words[SEQUENCE] += 1  # odd: being changed
        words[BASE], words[WALL], words[HORIZON] = line.base_ns, line.wall_ns, line.horizon_ns
        words[RATE], words[ACHIEVED] = round(line.rate * PPM), round(line.achieved * PPM)
        words[SEQUENCE] += 1

    def row(self, index: int) -> Row:
        at = HEAD + ROW * index
        return Row(bool(self.words[at + ACTIVE]), self.words[at + REACHED], self.words[at + SLACK])

    def join(self, index: int, reached_ns: int, slack_ns: int) -> None:
        """Take a row, and its lock."""
        at = HEAD + ROW * index
        lock(self.fd, 1 + index)
        self.words[at + REACHED], self.words[at + SLACK] = reached_ns, slack_ns
        self.words[at + ACTIVE] = 1

    def reach(self, index: int, until_ns: int) -> None:
        self.words[HEAD + ROW * index + REACHED] = until_ns

    def leave(self, index: int) -> None:
        self.words[HEAD + ROW * index + ACTIVE] = 0

    def is_driven(self) -> bool:
        """Whether the twin that writes it lives."""
        return locked_by_another(self.fd, 0)

    def is_alive(self, index: int) -> bool:
        """Whether the process that took a row lives."""
        return locked_by_another(self.fd, 1 + index)


def create(path: Path, names: Sequence[str], start_ns: int, line: Line) -> ClockFile:
    """A clock in place of an older one at `path`, locked by us. Names have at most 32 bytes."""
    new = path.with_suffix(".new")
    fd = os.open(new, os.O_RDWR | os.O_CREAT | os.O_TRUNC, 0o600)
    head = [0] * HEAD
    head[MAGIC_WORD], head[ROWS], head[START] = MAGIC, len(names), start_ns
    data = struct.pack(f"{HEAD}q", *head)
    for name in names:
        data += bytes(8 * NAME_WORD) + name.encode().ljust(NAME_BYTES, b"\0")
    os.write(fd, data)
    lock(fd, 0)
    file = ClockFile(fd)
    file.publish(line)
    new.rename(path)
    return file


def attach(path: Path) -> ClockFile | None:
    """The clock at `path`; None where there is none, or a file that is something else."""
    try:
        fd = os.open(path, os.O_RDWR)
    except OSError:
        return None
    size = os.fstat(fd).st_size
    head = os.pread(fd, 8 * HEAD, 0)
    if size < 8 * HEAD or struct.unpack_from("q", head)[0] != MAGIC:
        os.close(fd)
        return None
    return ClockFile(fd)


def lock(fd: int, byte: int) -> None:
    """Take a lock that ends with the file's last descriptor, so with us. Raises BlockingIOError: another has it."""
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0))


def locked_by_another(fd: int, byte: int) -> bool:
    answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0))
    return bool(_LOCK.unpack(answer)[0] != fcntl.F_UNLCK)
