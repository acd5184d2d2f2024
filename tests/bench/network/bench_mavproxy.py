"""MAVProxy as the ground station of three robots: when it sees them, and whom its commands reach.

The agents are processes with real sessions, loops and recordings, certificates and access rules; camera and motors are
a script. MAVProxy is 1.2 GB with all that it brings, so that it lives in an environment of its own:

    python3 -m venv ELSEWHERE && ELSEWHERE/bin/pip install MAVProxy setuptools future
    MAVPROXY=ELSEWHERE/bin/mavproxy.py python -m tests.bench mavproxy
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from agent.core.codec import decode
from agent.core.config import Fleet
from agent.core.messages import Answer
from agent.core.topics import ANSWER
from agent.ground.console import OrderConsole
from agent.process.certificates import credentials
from agent.process.transport import Observer
from tests.bench.network.bench_orders import agents_of_three
from tests.network.conftest import unused_port
from tests.places import ROOT

WELL_S = 60.0
QUIET_S = 2.0
SEEN_WANTED_S = 5.0
SEEN = re.compile(r"Detected vehicle (\d+):1")
MODULES = "link,mode,arm,cmdlong,param,misc,output"


def run() -> dict[str, dict[str, Any]]:
    program = os.environ.get("MAVPROXY") or shutil.which("mavproxy.py")
    if not program:
        sys.stderr.write("no MAVProxy: MAVPROXY=PATH of mavproxy.py; nothing is measured\n")
        return {}
    rows: dict[str, dict[str, Any]] = {}
    with agents_of_three("tls") as (fleet, path, processes):
        with OrderConsole(fleet, "ann", credentials(fleet, "ann", path)) as console:
            _until(lambda: len(console.states()) == len(fleet.robot))
        for first in ("MAVProxy", "bridge"):
            port = unused_port()
            bridge = [sys.executable, "-m", "agent", "bridge", "mavlink", str(path), "--as", "ann"]
            station = Station(program, port, str(path.parent)) if first == "MAVProxy" else None
            if station is not None:
                station.until("Waiting for heartbeat")
            began_s = time.monotonic()
            processes["bridge"] = subprocess.Popen([*bridge, "--port", str(port)], cwd=ROOT)
            if station is None:
                time.sleep(SEEN_WANTED_S)
                began_s = time.monotonic()
                station = Station(program, port, str(path.parent))
            processes["MAVProxy"] = station.process
            station.until_seen(len(fleet.robot))
            took_s = time.monotonic() - began_s
            last = "bridge" if first == "MAVProxy" else "MAVProxy"
            rows[f"three vehicles, {first} runs already: from the start of the {last}"] = {
                "value": took_s,
                "unit": "s",
                "against": f"{SEEN_WANTED_S:g} s",
                "ratio": took_s / SEEN_WANTED_S,
            }
            if first == "bridge":
                rows |= _orders(fleet, path, station)
            for name in ("MAVProxy", "bridge"):
                processes[name].kill()  # MAVProxy does not end otherwise
                processes[name].wait()
    return rows


def _orders(fleet: Fleet, path: Path, station: Station) -> dict[str, dict[str, Any]]:
    """Arm the first and have the third surface, as a person would type it."""
    keys = credentials(fleet, "ann", path)
    with Observer(fleet, time.time_ns, (ANSWER,), "view", credentials(fleet, "view", path) or keys) as observer:
        time.sleep(QUIET_S)
        took_ms = []
        for system, command, said in ((1, "arm throttle", "COMPONENT_ARM_DISARM"), (3, "mode SURFACE", "DO_SET_MODE")):
            station.types(f"vehicle {system}")
            time.sleep(QUIET_S)
            began_s = time.monotonic()
            station.types(command)
            station.until(f"{said}: ACCEPTED")
            took_ms.append(1e3 * (time.monotonic() - began_s))
        time.sleep(QUIET_S)
        answers = [decode(one.payload, Answer) for one in observer.drain()]
    reached = [(answer.robot, answer.order, answer.ok) for answer in answers]
    wanted = [("r1", "arm", True), ("r3", "surface", True)]
    assert reached == wanted, reached
    return {
        "robots that arm and SURFACE reached, of 2 addressed and 3": {"value": float(len(reached)), "unit": "robots"},
        "typed to acknowledged, the slower of 2": {"value": max(took_ms), "unit": "ms"},
    }


class Station:
    """MAVProxy as a process, and what it has printed."""

    def __init__(self, program: str, port: int, folder: str) -> None:
        command = [program, f"--master=udpin:127.0.0.1:{port}", "--default-modules", MODULES, "--state-basedir", folder]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder
        )
        self._said = ""
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        while piece := self.process.stdout.read(1):
            self._said += piece

    def types(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def until(self, text: str) -> None:
        _until(lambda: text in self._said, lambda: self._said)

    def until_seen(self, vehicles: int) -> None:
        _until(lambda: len(set(SEEN.findall(self._said))) == vehicles, lambda: self._said)


def _until(true: Callable[[], bool], told: Callable[[], str] = str) -> None:
    ends_s = time.monotonic() + WELL_S
    while not true():
        assert time.monotonic() < ends_s, told()
        time.sleep(0.02)
