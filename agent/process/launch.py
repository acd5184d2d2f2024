"""Processes of ours, started as a user would start them. Stopped whatever happens; they end with us."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from agent.clock import machine
from agent.process.failure import Failed
from agent.process.parent_watch import GRACE_S, ParentWatch, watched_by_us

STOP_S = GRACE_S  # from SIGTERM to SIGKILL


class Child(NamedTuple):
    """A process and where its output goes."""

    name: str
    process: subprocess.Popen[bytes]
    log: Path


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
        """Wait until one of these processes has ended by itself. Raises Failed if it says no, or all take too long."""
        deadline_s = machine.monotonic_s() + timeout_s
        while (child := next((c for c in self._children if c.process.poll() is not None), None)) is None:
            if machine.monotonic_s() > deadline_s:
                slow = self._children[0]
                raise Failed(f"{slow.name} took longer than {timeout_s:.0f} s; its output is in {slow.log}")
            machine.sleep(0.05)
        if child.process.returncode != 0:
            raise Failed(f"{child.name} failed: {last_line(child.log)}")
        self._children.remove(child)

    def stop(self, *names: str) -> list[str]:
        """SIGTERM to these at once, SIGKILL to whoever is left after a while; all are reaped.

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
