"""Processes of ours, started as a user would start them and stopped whatever happens: they end with their parent. Free
ports, the signal that ends a command, and memory.
"""

from __future__ import annotations

import contextlib
import os
import resource
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from threading import Condition, Event, RLock, Thread, Timer, main_thread
from typing import NamedTuple

from agent.clock import machine
from agent.core.config import ConfigError
from agent.process.command import Failed
from agent.robot.fleet_reader import MAX_PORT

# --- a process that ends with its parent ---
# A process that ends with the one that started it, however that ended: after SIGKILL nobody can stop his children.
#
# They share a pipe. Only the parent can write to it, and it never does; when the parent has gone, the kernel closes
# its end, and who reads at the other one wakes up. Linux could do the same with prctl, other systems could not.

VARIABLE = "AUCAMP_PARENT_WATCH"  # of the child's environment: the number of the descriptor to read from
GRACE_S = 20.0  # from SIGTERM to the end at once: under 2 s alone, but a recorder beside a load finishes its file


class ParentWatch(NamedTuple):
    """The pipe, in the parent: one for any number of children."""

    held: int
    given: int  # to be inherited, by Popen's pass_fds

    def environment(self) -> Mapping[str, str]:
        return {**os.environ, VARIABLE: str(self.given)}

    def drop(self) -> None:
        """Children that still run end."""
        os.close(self.held)
        os.close(self.given)


def watched_by_us() -> ParentWatch:
    """Only what is passed on by pass_fds is inherited: no child holds the end that is ours."""
    given, held = os.pipe()
    return ParentWatch(held, given)


def exit_with_parent() -> None:
    """Call it in a child's main thread: SIGTERM comes when the parent has gone. Without a watch it runs free."""
    number = os.environ.pop(VARIABLE, None)  # our own children have another parent
    if number is not None:
        Thread(target=_watch, args=(int(number),), name="parent watch", daemon=True).start()


def _watch(given: int) -> None:
    try:
        os.read(given, 1)
    except OSError:
        return  # not ours: a variable that somebody has handed on
    signal.pthread_kill(main_thread().ident or 0, signal.SIGTERM)  # to the main thread, so that it stops waiting
    machine.sleep(GRACE_S)
    os._exit(128 + signal.SIGTERM)  # it hangs, or compiles


# --- processes of ours ---

STOP_S = GRACE_S  # from SIGTERM to SIGKILL


class Child(NamedTuple):
    """A process and where its output goes."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path


MOVES_S = 0.1  # of a processor's time: who works for so long does not stand still


def busy_s(pid: int) -> float:
    """Processor's time of a process and of those that it has begun; 0 where the system does not say (Linux)."""
    try:
        # behind the name, which may have blanks: user and system time, and those of children that have ended
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except (OSError, ValueError):
        return 0.0
    own = sum(map(int, fields[11:15])) / os.sysconf("SC_CLK_TCK")
    return own + sum(busy_s(int(child)) for child in children)


class Crew:
    """The processes of one run, in order of start; stopped in the opposite order."""

    def __init__(self, logs: Path, environment: Mapping[str, str] | None = None) -> None:
        """`environment`: variables that these processes have beside ours, or in the place of ours."""
        self._logs, self._environment = logs, environment or {}
        self._children: list[Child] = []
        self._watch: ParentWatch | None = None

    def start(self, name: str, *arguments: str) -> None:
        """Start `aucamp ARGUMENTS`, its output going to <logs>/<name>.log."""
        self._logs.mkdir(parents=True, exist_ok=True)
        log = self._logs / f"{name}.log"
        self._watch = self._watch or watched_by_us()
        with log.open("wb") as out:
            process = subprocess.Popen(
                # A crash in compiled code leaves in the log where it was called from.
                [sys.executable, "-X", "faulthandler", "-m", "agent", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                pass_fds=(self._watch.given,),
                env={**self._watch.environment(), **self._environment},
                process_group=0,  # Ctrl-C is for us; we then end the crew in order
            )
        self._children.append(Child(name, process, log))

    def check(self) -> None:
        """Raise Failed if one that should run has ended."""
        for child in self._children:
            if child.process.poll() is not None:
                raise Failed(f"{child.name} ended by itself ({how_it_ended(child)}): {last_line(child.log)}")

    def finish_one(self, timeout_s: float) -> None:
        """Wait until one of these processes has ended by itself. Raises Failed if it says no, or if the first of them
        works for longer than `timeout_s` of a processor's time, or stands still for as long.

        On a busy machine work takes longer by the wall, and no longer by the processor.
        """
        slow = self._children[0]
        before_s, moved_s = busy_s(slow.process.pid), machine.monotonic_s()
        began_s = before_s
        while (child := next((c for c in self._children if c.process.poll() is not None), None)) is None:
            now_s, worked_s = machine.monotonic_s(), busy_s(slow.process.pid)
            if worked_s - before_s > MOVES_S:
                before_s, moved_s = worked_s, now_s
            if max(now_s - moved_s, worked_s - began_s) > timeout_s:
                how = "stood still" if now_s - moved_s > timeout_s else "worked"
                raise Failed(f"{slow.name} {how} for longer than {timeout_s:.0f} s; its output is in {slow.log}")
            machine.sleep(0.05)
        if child.process.returncode != 0:
            raise Failed(f"{child.name} failed: {last_line(child.log)}")
        self._children.remove(child)

    def stop(self, *names: str) -> list[str]:
        """SIGTERM to these at once, SIGKILL to those that are left after a while; all are reaped.

        Returns a line for each that did not end well: its work may not be done.
        """
        children = [self._child(name) for name in names]
        for child in children:
            if child.process.poll() is None:
                child.process.send_signal(signal.SIGTERM)
        deadline_s = machine.monotonic_s() + STOP_S
        for child in children:
            try:
                child.process.wait(max(0.0, deadline_s - machine.monotonic_s()))
            except subprocess.TimeoutExpired:
                child.process.kill()
                child.process.wait()
            self._children.remove(child)
        well = (0, 128 + signal.SIGTERM, -signal.SIGTERM)
        bad = [child for child in children if child.process.returncode not in well]
        return [f"{child.name} did not end well ({how_it_ended(child)}): {last_line(child.log)}" for child in bad]

    def stop_all(self) -> None:
        """The youngest first."""
        for child in reversed(self._children.copy()):
            self.stop(child.name)
        if self._watch is not None:
            self._watch.drop()
            self._watch = None

    def _child(self, name: str) -> Child:
        return next(child for child in self._children if child.name == name)


@contextlib.contextmanager
def crew(logs: Path, environment: Mapping[str, str] | None = None) -> Iterator[Crew]:
    """A crew whose processes do not outlive the block."""
    processes = Crew(logs, environment)
    try:
        yield processes
    finally:
        processes.stop_all()


def wait_for(what: str, ready: Callable[[], bool], processes: Crew, timeout_s: float) -> None:
    """Poll until ready. Raises Failed when a process ends meanwhile or time runs out."""
    deadline_s = machine.monotonic_s() + timeout_s
    while not ready():
        processes.check()
        if machine.monotonic_s() > deadline_s:
            raise Failed(f"{what} was not ready after {timeout_s:.0f} s")
        machine.sleep(0.05)


def how_it_ended(child: Child) -> str:
    """The signal or the exit code."""
    code = child.process.returncode
    return f"signal {signal.Signals(-code).name}" if code is not None and code < 0 else f"exit {code}"


def last_line(log: Path) -> str:
    """What a process said last, and where the rest is."""
    try:
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    except OSError:  # somebody has cleared it away
        lines = []
    return f"{lines[-1]} (all in {log})" if lines else f"no output in {log}"


# --- free ports ---
# Ports of this computer: which are free, asked as Zenoh asks, by binding them for a moment.

# Above the ports of the fleet files that ship and of the router, up to 29340: well below the ephemeral range.
FIRST_PORT, PORTS_APART, PLACES = 17501, 8, 1480

Address = tuple[socket.AddressFamily, tuple[str | int | bytes, ...]]


def addresses_of(endpoint: str) -> list[Address]:
    """Where tcp/HOST:PORT is: of a name that stands for several addresses all of them; none for no such host."""
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    try:
        found = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):  # the latter of what is no name of any host
        return []
    return [(family, address) for family, _, _, _, address in found]


def bind_error(address: Address) -> int | None:
    """The number of the error with which binding is refused; None: it is free. Connections that linger do not count."""
    family, where = address
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(where)
        except OSError as error:
            return error.errno
    return None


def is_free(endpoint: str) -> bool:
    """Whether tcp/HOST:PORT is this computer's and nobody listens there, at any address of the host."""
    found = addresses_of(endpoint)
    return bool(found) and all(bind_error(address) is None for address in found)


def free_ports(count: int, first: int | None = None) -> list[int]:
    """Ports on loopback that nobody listens on now, below the ephemeral range.

    Where to begin depends on the process: two runs that choose at the same time do not choose the same. Raises Failed
    where there are not so many.
    """
    first = first or FIRST_PORT + PORTS_APART * (os.getpid() % PLACES)
    ports: list[int] = []
    for port in range(first, MAX_PORT):
        if len(ports) == count:
            return ports
        if bind_error((socket.AF_INET, ("127.0.0.1", port))) is None:
            ports.append(port)
    raise Failed(f"fewer than {count} free ports from {first} to {MAX_PORT}")


# --- stop signal ---
# How a command that runs until it is ended learns that it shall end.

AGAIN_S = 0.5  # a wait without end looks as often by itself

_asked: list[int] = []  # signals that came while nobody waited for one yet


class Stop(Event):
    """An event that a signal may set. Its handler runs in the main thread, maybe in the middle of a wait for this very
    event: threading's own would then wait for its own lock for ever."""

    def __init__(self) -> None:
        super().__init__()
        self._changed = Condition(RLock())
        self._happened = False

    def is_set(self) -> bool:
        return self._happened

    def set(self) -> None:
        with self._changed:
            self._happened = True
            self._changed.notify_all()

    def wait(self, timeout: float | None = None) -> bool:
        """A signal between the look and the sleep goes unheard by this sleep, so none is without end."""
        with self._changed:
            while not self._happened:
                self._changed.wait(AGAIN_S if timeout is None else timeout)
                if timeout is not None:
                    break
        return self._happened


class Leaving(SystemExit):
    """A signal ends the program. Where this is dropped on its way, as Python does with what is raised in a callback
    while it imports or compiles, the signal comes again; `arrived` says that it need not."""

    def __init__(self, number: int) -> None:
        super().__init__(128 + number)
        self.arrived = False
        self._number = number

    def __del__(self) -> None:
        if not self.arrived and not sys.is_finalizing():  # no thread starts then: start() would wait for ever
            again = Timer(AGAIN_S, _come_again, (self._number,))
            again.daemon = True
            again.start()


def _come_again(number: int) -> None:
    if signal.getsignal(number) is leave:  # else `until_signal`, which remembers, has taken over
        signal.pthread_kill(main_thread().ident or 0, number)


def leave(number: int, frame: object) -> None:
    """A signal ends the program as Ctrl-C does, so that what it started ends with it."""
    _asked.append(number)
    raise Leaving(number)


@contextmanager
def until_signal() -> Iterator[Event]:
    """An event that Ctrl-C, SIGTERM and a terminal that is closed set; a second one interrupts whatever still runs."""
    stop = Stop()
    if _asked:
        stop.set()

    def handle(number: int, frame: object) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    ours = [signal.SIGTERM, signal.SIGINT]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:  # nohup means it
        ours.append(signal.SIGHUP)
    before = {number: signal.signal(number, handle) for number in ours}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


# --- memory ---
# Libraries that find no memory end the process, or hang, at any place: better it does not start.

# What an agent of two cores takes in a dive, a tenth added: of data (`ulimit -d`) and of addresses (`ulimit -v`), MB.
AGENT_TAKES_MB = {"d": (resource.RLIMIT_DATA, 600), "v": (resource.RLIMIT_AS, 2000)}


def refuse_too_little_memory() -> None:
    """Raises ConfigError where this process may not have what an agent takes. To be called before it is loaded."""
    for option, (limit, takes_mb) in AGENT_TAKES_MB.items():
        most, _ = resource.getrlimit(limit)
        if most != resource.RLIM_INFINITY and most < takes_mb * 10**6:
            text = f"a process may have {most // 10**6} MB of memory here, and an agent takes {takes_mb}"
            raise ConfigError(f"{text}; run: ulimit -{option} {takes_mb * 1000}")
