"""Processes that claims of networks start on this machine: their fleets, what they use, and failures in one line."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from msgspec.structs import replace

from agent.core.config import Access, ConfigError, Fleet, dump
from agent.demo.demo import demo_fleet
from agent.ground.new_fleet import make_all
from agent.process.command import Failed
from tests.killing import killed_after
from tests.network.relay import Relay, refused
from tests.network.swarm_in_namespaces import WATCHER, Swarm
from tests.places import ROOT

TICK_HZ = os.sysconf("SC_CLK_TCK")
LONGEST = 300  # characters of what is said of a failure
Processes = dict[str, subprocess.Popen[Any]]


class Made(NamedTuple):
    """A fleet, its file, and the folder of its keys."""

    fleet: Fleet
    path: Path
    keys: Path


def made(folder: Path, kind: str, ports: Sequence[int], name: str = "tank", reach: int | None = None) -> Made:
    """A robot for each port of this computer, by the system's clock, side by side where the tank's first one stands.

    kind: "tcp", or "tls" with certificates and access rules. Its neighbours are all others, or as many on either side
    along a ring as `reach` says.
    """
    pattern, count = demo_fleet(1, "evidence", 0.0, 0, False, folder), len(ports)
    names = [f"r{k + 1}" for k in range(count)]
    robots = {}
    for k, port in enumerate(ports):
        away = [min((j - k) % count, (k - j) % count) for j in range(count)]
        near = tuple(other for other, steps in zip(names, away, strict=True) if 0 < steps <= (reach or count))
        endpoint, device = f"{kind}/127.0.0.1:{port}", f"/dev/null{port}"
        robots[names[k]] = replace(
            pattern.robot["r1"], neighbours=near, listen=endpoint, serial=device, camera=f"v4l2:{device}"
        )
    access = Access(keys="keys", consoles=("ann",)) if kind == "tls" else Access()
    one = Made(replace(pattern, fleet=name, robot=robots, access=access), folder / f"{name}.toml", folder / "keys")
    folder.mkdir(exist_ok=True)
    if kind == "tls":
        make_all(one.fleet, one.keys)
    one.path.write_text(dump(one.fleet), encoding="utf-8")
    return one


def python(*words: str, **options: Any) -> subprocess.Popen[Any]:
    """A program of this repository."""
    return subprocess.Popen([sys.executable, *words], cwd=ROOT, **options)


@contextmanager
def agents(one: Made) -> Iterator[Processes]:
    """A scripted agent for each robot; all processes that are there in the end are ended."""
    processes: Processes = {}
    with killed_after(processes):
        for name in one.fleet.robot:
            processes[name] = python("-m", "tests.network.scripted_agent", str(one.path), name, str(one.path.parent))
        yield processes


def used_s(pid: int) -> float:
    """Processor time by Linux' /proc, of all threads."""
    words = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / TICK_HZ


def resident_mb(pid: int) -> float:
    """Memory by Linux' /proc; shared libraries count in full for each process."""
    (line,) = (s for s in Path(f"/proc/{pid}/status").read_text().splitlines() if s.startswith("VmRSS:"))
    return float(line.split()[1]) / 1024.0


@contextmanager
def swarm_of(count: int) -> Iterator[Swarm]:
    """So many robots are started, each on a host of its own, a network namespace.

    Raises ConfigError where this machine gives none.
    """
    if (why := refused()) is not None:
        raise ConfigError(f"network namespaces are not to be had on this machine: {why}")
    names = [f"r{k + 1}" for k in range(count)]
    with Relay([*names, WATCHER], set(names)) as relay, tempfile.TemporaryDirectory() as folder:
        swarm = Swarm(relay, dict.fromkeys(names, 0.0), Path(folder))
        try:
            swarm.start(*names)
            yield swarm
        finally:
            swarm.stop()


@contextmanager
def in_one_line() -> Iterator[None]:
    """What was waited or hoped for in vain is a failure of the run. Around a function, as a decorator."""
    try:
        yield
    except AssertionError as error:
        raise Failed(" ".join(str(error).split())[:LONGEST] or "what was measured went wrong") from error
