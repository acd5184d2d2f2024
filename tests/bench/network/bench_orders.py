"""How soon robots answer: a stop for all of three, over links with and without keys, and one robot that hangs.

The agents are processes with real sessions, the real loop and the real recording; camera and motors are a script. Run
apart: python -m tests.bench orders
"""

from __future__ import annotations

import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from agent.core.config import Access, Fleet, dump
from agent.demo.demo import demo_fleet
from agent.ground.console import OrderConsole
from agent.ground.new_fleet import make_all
from agent.process.certificates import credentials
from agent.process.launch import free_ports
from tests.killing import killed_after
from tests.places import ROOT

STOPS = 60
WELL_S = 120.0
WANTED_MS, NAMED_WANTED_S = 150.0, 1.1


def run() -> dict[str, dict[str, Any]]:
    rows: dict[str, dict[str, Any]] = {}
    for kind in ("tcp", "tls"):
        with three(kind) as (console, processes):
            took_ms = [1e3 * outcome.took_s for _ in range(STOPS) for outcome in stops(console)]
            rows[f"stop all of three, {kind}: median"] = {"value": statistics.median(took_ms), "unit": "ms"}
            worst = max(took_ms)
            rows[f"stop all of three, {kind}: slowest of {len(took_ms)}"] = {
                "value": worst,
                "unit": "ms",
                "against": f"{WANTED_MS:g} ms",
                "ratio": worst / WANTED_MS,
            }
            clock_ms = [1e3 * o.took_s for _ in range(STOPS) for o in console.order(["r1"], "clock").values()]
            rows[f"what time it is, {kind}: median"] = {"value": statistics.median(clock_ms), "unit": "ms"}
            processes["r2"].send_signal(signal.SIGSTOP)
            outcomes = console.order(["r1", "r2", "r3"], "stop")
            processes["r2"].send_signal(signal.SIGCONT)
            hung = outcomes.pop("r2")
            assert hung.answer is None and all(outcome.ok for outcome in outcomes.values())
            others = max(1e3 * outcome.took_s for outcome in outcomes.values())
            rows[f"one hangs, {kind}: it is named"] = {
                "value": hung.took_s,
                "unit": "s",
                "against": f"{NAMED_WANTED_S:g} s",
                "ratio": hung.took_s / NAMED_WANTED_S,
            }
            rows[f"one hangs, {kind}: the slower of the others"] = {"value": others, "unit": "ms"}
    return rows


def stops(console: OrderConsole) -> Iterator[Any]:
    outcomes = console.order(["r1", "r2", "r3"], "stop")
    assert all(outcome.ok for outcome in outcomes.values()), outcomes
    time.sleep(0.037)  # not in step with the loops
    yield from outcomes.values()


@contextmanager
def agents_of_three(kind: str) -> Iterator[tuple[Fleet, Path, dict[str, subprocess.Popen[Any]]]]:
    """Processes of scripted agents, and the fleet file that they have read; all that is among them in the end ends."""
    with tempfile.TemporaryDirectory() as folder:
        fleet, path = of_three(kind, Path(folder)), Path(folder) / "fleet.toml"
        path.write_text(dump(fleet), encoding="utf-8")
        processes: dict[str, subprocess.Popen[Any]] = {}
        with killed_after(processes):
            for name in fleet.robot:
                agent = [sys.executable, "-m", "tests.network.scripted_agent", str(path), name, folder]
                processes[name] = subprocess.Popen(agent, cwd=ROOT)
            yield fleet, path, processes


@contextmanager
def three(kind: str) -> Iterator[tuple[OrderConsole, dict[str, subprocess.Popen[bytes]]]]:
    """Three robots that a console hears."""
    with (
        agents_of_three(kind) as (fleet, path, processes),
        OrderConsole(fleet, "ann", credentials(fleet, "ann", path)) as console,
    ):
        ends_s = time.monotonic() + WELL_S
        while len(console.states()) < len(fleet.robot):
            assert time.monotonic() < ends_s, console.states().keys()
            time.sleep(0.1)
        yield console, processes


def of_three(kind: str, folder: Path) -> Fleet:
    """By the system's clock, on this computer."""
    fleet = demo_fleet(3, "evidence", 0.0, 0, False, folder)
    robots = {
        name: replace(
            robot, listen=f"{kind}/127.0.0.1:{port}", serial=f"/dev/null{port}", camera=f"v4l2:/dev/null{port}"
        )
        for (name, robot), port in zip(fleet.robot.items(), free_ports(3), strict=True)
    }
    fleet = replace(fleet, robot=robots)
    if kind == "tls":
        fleet = replace(fleet, access=Access(keys=str(folder / "keys"), consoles=("ann",)))
        make_all(fleet, folder / "keys")
    return fleet
