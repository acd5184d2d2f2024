"""The clocks that a process may live by: the system's own, with real devices, and that of a dive in the twin."""

from __future__ import annotations

import contextlib
import fcntl
import mmap
import os
import struct
from collections.abc import Sequence
from pathlib import Path
from threading import Condition, Event, Lock
from typing import NamedTuple, Protocol

from agent.clock import machine

REST_NS = 1 << 62  # "wake me for news only": later than anything


class Clock(Protocol):
    """Unix time in nanoseconds that never steps back. It may run faster or slower than the wall's, or stand."""

    camera_offset_ns: int  # from the stamps of cameras that live by this clock to its own time

    @property
    def start_ns(self) -> int | None:
        """When the dive began, in its own time; None: there is no twin."""

    def now_ns(self) -> int: ...

    def wall_s(self, until_ns: int) -> float:
        """How long to sleep on the wall before looking again whether it is `until_ns`; 0: it is."""

    def rate(self) -> float:
        """Seconds of this clock in a second of the wall, of late."""

    def is_driven(self) -> bool:
        """Whether the twin whose time it is runs; always true of the system's clock."""

    def join(self, part: str, slack_ns: int) -> None:
        """From now on this clock waits for a part of this process: it goes no further than slack_ns beyond what
        the part has reached."""

    def reach(self, part: str, until_ns: int) -> None:
        """The part has done everything that is due before until_ns."""

    def leave(self, part: str) -> None:
        """The clock does not wait for the part any more."""


class SystemClock:
    """Sampled once, then monotonic: an adjustment of the time of day is no event of a dive. It waits for no part."""

    start_ns: int | None = None

    def __init__(self) -> None:
        self.camera_offset_ns = machine.unix_ns() - machine.monotonic_ns()

    def now_ns(self) -> int:
        return self.camera_offset_ns + machine.monotonic_ns()

    def wall_s(self, until_ns: int) -> float:
        return max(0.0, (until_ns - self.now_ns()) * 1e-9)

    def rate(self) -> float:
        return 1.0

    def is_driven(self) -> bool:
        return True

    def join(self, part: str, slack_ns: int) -> None:
        pass

    def reach(self, part: str, until_ns: int) -> None:
        pass

    def leave(self, part: str) -> None:
        pass


class StandingClock(SystemClock):
    """It is always the same time, and stamps stay as they are: for frames of a recording."""

    def __init__(self, at_ns: int = 0) -> None:
        self.camera_offset_ns, self._at_ns = 0, at_ns

    def now_ns(self) -> int:
        return self._at_ns


def wait(clock: Clock, event: Event, seconds: float) -> bool:
    """Whether the event was set within so many seconds of the clock."""
    return wait_until(clock, event, clock.now_ns() + round(seconds * 1e9))


def wait_until(clock: Clock, event: Event, until_ns: int) -> bool:
    """Whether the event was set before it was until_ns."""
    while (left_s := clock.wall_s(until_ns)) > 0.0:
        if event.wait(left_s):
            return True
    return event.is_set()


class Part:
    """One thread that a clock waits for, such as an agent's loop; used by that thread, except for `resume`.

    It holds the clock back while it works, never while it waits.
    """

    def __init__(self, clock: Clock, name: str, slack_s: float) -> None:
        self._clock, self._name = clock, name
        clock.join(name, round(slack_s * 1e9))

    def wait(self, event: Event, until_ns: int) -> None:
        """Return when it is until_ns, or the event is set."""
        self._clock.reach(self._name, until_ns)
        wait_until(self._clock, event, until_ns)

    def wait_changed(self, condition: Condition, until_ns: int) -> bool:
        """Return when the condition, held by the caller, may have been notified (True), or it is until_ns (False)."""
        self._clock.reach(self._name, until_ns)
        left_s = self._clock.wall_s(until_ns)
        if left_s > 0.0:
            condition.wait(left_s)
        return left_s > 0.0

    def resume(self) -> None:
        """Work has come, or is about to: called by the thread that brings it, before the waiting thread knows of it."""
        self._clock.reach(self._name, self._clock.now_ns())

    def rest(self) -> None:
        """Nothing to do until news comes."""
        self._clock.reach(self._name, REST_NS)

    def leave(self) -> None:
        """The thread ends."""
        self._clock.leave(self._name)


# --- clock file ---
# The file in which a dive's clock stands, mapped by every process of the dive: numbers of 64 bits, nothing else.
#
# The twin writes the head: a line, by which run time follows from the machine's monotonic clock, and the horizon, which
# it must not cross. Each part of the dive writes a row: how far it has come. A number is written whole, the head
# between two changes of its sequence number. A writer holds a lock on one byte, the twin on the first, a process on
# that of its row, and the kernel of the machine releases the locks of a process that died: no process has to be asked
# whether it lives.

MAGIC = int.from_bytes(b"AUCLOCK1", "little")
HEAD, ROW = 16, 8  # numbers in the head, in a row
NAME_WORD, NAME_BYTES = 4, 32
MAGIC_WORD, SEQUENCE, BASE, WALL, RATE, HORIZON, ROWS, START, ACHIEVED = range(9)  # of the head
ACTIVE, REACHED, SLACK = range(3)  # of a row
PPM = 1_000_000

FARTHEST_NS = 2**62  # the year 2116
LOOKS = 1000  # at a line that is being changed: it takes a writer a millionth of a second

_LOCK = struct.Struct("hhqqi4x")  # struct flock of 64-bit Linux: type, whence, start, length, process


class Line(NamedTuple):
    """Run time as a function of the wall's: base_ns + rate * (monotonic - wall_ns), at most horizon_ns."""

    base_ns: int
    wall_ns: int
    rate: float
    horizon_ns: int
    achieved: float = 1.0  # the rate of late, standing still included

    def at(self, monotonic_ns: int) -> int:
        """Run time without the horizon."""
        return self.base_ns + round(self.rate * (monotonic_ns - self.wall_ns))

    def left_at(self, monotonic_ns: int) -> int:
        """Run time at the wall's pace, once no twin drives it any more."""
        return self.base_ns + monotonic_ns - self.wall_ns


class Row(NamedTuple):
    """How far a part has come, and how much further the clock may go."""

    active: bool
    reached_ns: int
    slack_ns: int


class ClockFile:
    """One mapping of the file. `words` is shared with every process that maps it."""

    def __init__(self, fd: int) -> None:
        """Raises ValueError for a file that is no whole clock."""
        self.fd = fd
        self._map = mmap.mmap(fd, 0)
        count = struct.unpack_from("q", self._map, 8 * ROWS)[0]
        if len(self._map) != 8 * (HEAD + ROW * count):
            raise ValueError("rows that are not there")
        names = (bytes(self._map[8 * (HEAD + ROW * i + NAME_WORD) :][:NAME_BYTES]) for i in range(count))
        self.rows = {name.rstrip(b"\0").decode(): i for i, name in enumerate(names)}
        self.words = memoryview(self._map).cast("q")
        self._newest: Line | None = None

    def close(self) -> None:
        self.words.release()
        self._map.close()
        os.close(self.fd)

    def line(self) -> Line:
        """The newest that is whole: a twin that was killed may have left half of one. Raises ValueError where none
        ever was."""
        words = self.words
        for _ in range(LOOKS):
            before = words[SEQUENCE]
            line = Line(words[BASE], words[WALL], words[RATE] / PPM, words[HORIZON], words[ACHIEVED] / PPM)
            if before == words[SEQUENCE] and not before & 1:
                self._newest = line
                return line
        if self._newest is None:
            raise ValueError("no whole line")
        return self._newest

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
        """Whether the twin that writes it runs."""
        return locked_by_another(self.fd, 0)

    def is_alive(self, index: int) -> bool:
        """Whether the process that took a row runs."""
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
    try:
        file = ClockFile(fd)
        line = file.line()
        if line.rate <= 0.0 or max(abs(line.base_ns), abs(line.wall_ns), abs(line.horizon_ns)) > FARTHEST_NS:
            raise ValueError("no line of a twin")
    except ValueError:
        os.close(fd)
        return None
    return file


def lock(fd: int, byte: int) -> None:
    """Take a lock that ends with the file's last descriptor, so with this process.

    Raises BlockingIOError where another process has it.
    """
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0))


def locked_by_another(fd: int, byte: int) -> bool:
    answer = fcntl.fcntl(fd, fcntl.F_OFD_GETLK, _LOCK.pack(fcntl.F_WRLCK, os.SEEK_SET, byte, 1, 0))
    return bool(_LOCK.unpack(answer)[0] != fcntl.F_UNLCK)


# --- clock of a dive ---
# The clock of a dive in the twin, as every process but the twin holds it.
#
# Where no twin runs it is the system's clock. Where one starts, or starts again, it follows that one. Where one dies it
# goes on from where it was, at the wall's pace: robots whose water has vanished still talk. It never steps back.

SHORTEST_S, LONGEST_S = 0.0005, 0.05  # sleeps between two looks at a clock that may change its rate, or stand
AGAIN_NS = 50_000_000  # of the wall, between two looks whether a twin has come or gone


class RunClock:
    """Threads of one process share it. See Clock for what the methods promise."""

    camera_offset_ns = 0  # the twin's cameras stamp with run time

    def __init__(self, path: Path) -> None:
        """`path`: where the twin writes its clock (hw.twin.twin_folder.clock_path)."""
        self._path, self._system = path, SystemClock()
        self._file: ClockFile | None = None
        self._inode = -1
        self._driven = False
        self._looked_ns = -AGAIN_NS
        self._last_ns = 0
        self._parts: dict[str, int] = {}  # that we joined with, and their slack
        self._lock = Lock()  # while the file is exchanged, and for the last time told

    def now_ns(self) -> int:
        wall_ns = machine.monotonic_ns()
        line = self._line(wall_ns)
        if line is None:
            now_ns = self._system.now_ns()
        else:
            now_ns = line.at(wall_ns)
            if now_ns > line.horizon_ns:
                now_ns = line.horizon_ns if self._is_driven(wall_ns) else line.left_at(wall_ns)
        with self._lock:
            self._last_ns = now_ns = max(now_ns, self._last_ns)
        return now_ns

    def wall_s(self, until_ns: int) -> float:
        now_ns = self.now_ns()
        if now_ns >= until_ns:
            return 0.0
        wall_ns = machine.monotonic_ns()
        line = self._line(wall_ns)
        if line is None or not self._driven:
            return min((until_ns - now_ns) * 1e-9, LONGEST_S)
        standing_s = (line.at(wall_ns) - line.horizon_ns) * 1e-9 / line.rate
        if standing_s > 0.0:  # the longer it has stood, the longer it may
            return min(max(standing_s / 4.0, SHORTEST_S), LONGEST_S)
        return min(max((until_ns - now_ns) * 1e-9 / line.rate, SHORTEST_S), LONGEST_S)

    def rate(self) -> float:
        line = self._line(machine.monotonic_ns())
        return line.achieved if line is not None and self._driven else 1.0

    def is_driven(self) -> bool:
        return self._is_driven(machine.monotonic_ns(), again_ns=0)

    @property
    def start_ns(self) -> int | None:
        """When the dive began, in its own time; None: there is no twin."""
        return self._file.words[START] if self._file is not None else None

    def join(self, part: str, slack_ns: int) -> None:
        self.now_ns()  # looks for a twin
        with self._lock:
            self._parts[part] = slack_ns
            self._take_row(part, self._last_ns)

    def reach(self, part: str, until_ns: int) -> None:
        if self._file is not None and (index := self._file.rows.get(part)) is not None:
            self._file.reach(index, until_ns)

    def leave(self, part: str) -> None:
        with self._lock:
            self._parts.pop(part, None)
            if self._file is not None and (index := self._file.rows.get(part)) is not None:
                self._file.leave(index)

    def _take_row(self, part: str, reached_ns: int) -> None:
        if self._file is not None and (index := self._file.rows.get(part)) is not None:
            with contextlib.suppress(BlockingIOError):  # another process dives as this robot: its links will say so
                self._file.join(index, reached_ns, self._parts[part])

    def _line(self, wall_ns: int) -> Line | None:
        if self._file is None or not self._driven:
            self._is_driven(wall_ns)
        return self._file.line() if self._file is not None else None

    def _is_driven(self, wall_ns: int, again_ns: int = AGAIN_NS) -> bool:
        """Whether the twin that we follow runs; looks for another one, but not all the time."""
        if wall_ns - self._looked_ns >= again_ns:
            with self._lock:
                self._looked_ns = wall_ns
                self._driven = self._file is not None and self._file.is_driven()
                if not self._driven:
                    self._follow_newest()
        return self._driven

    def _follow_newest(self) -> None:
        try:
            inode = self._path.stat().st_ino
        except OSError:
            return
        if inode == self._inode or (file := attach(self._path)) is None:
            return
        if not file.is_driven() and (self._file is not None or not self._is_ahead(file.line())):
            file.close()
            return
        self._file, self._inode = file, inode  # the old mapping stays: another thread may be reading it
        self._driven = file.is_driven()
        for part in self._parts:
            self._take_row(part, self._last_ns)

    def _is_ahead(self, line: Line) -> bool:
        """Whether a twin that died before we came, but not before the machine started, left time beyond the time of
        day: our time must not be behind that of the processes that outlived it."""
        wall_ns = machine.monotonic_ns()
        return line.wall_ns <= wall_ns and line.left_at(wall_ns) > self._system.now_ns()


# --- parts of a dive ---
# Of each robot the three threads of its agent that time waits for.

LOOP, CAMERA, SERIAL = PARTS = ("loop", "camera", "serial")


def part_name(robot: str, part: str) -> str:
    """The name of a part, such as r1.loop."""
    return f"{robot}.{part}"
