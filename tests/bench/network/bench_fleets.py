"""One recorder for ten fleets of three: what it costs against one for one, and whether anything is missing.

The robots are sessions of one other process, which say and show what real ones do, at their rates, previews included.
Run apart: python -m tests.bench fleets
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec

from agent.core.config import Access, dump
from agent.demo.demo import demo_fleet
from agent.ground.new_fleet import make_all
from agent.process.launch import free_ports
from replay.files.log import read
from tests.places import ROOT
from tests.waiting import until

FLEETS, ROBOTS = 10, 3
COUNTED_S = 20.0
TICK_HZ = os.sysconf("SC_CLK_TCK")


def run() -> dict[str, dict[str, Any]]:
    one, ten, secured = measured(1, False), measured(FLEETS, False), measured(FLEETS, True)
    rows = {}
    for name, figure, against in (
        ("fleets10", ten, one),
        ("fleets10_tls", secured, ten),
    ):
        other = "one fleet" if against is one else "the same on tcp"
        rows |= {
            f"{name}_{what}": {
                "value": figure[what],
                "unit": unit,
                "against": other,
                "ratio": figure[what] / against[what] if against[what] else None,
            }
            for what, unit in UNITS.items()
        }
    return rows


UNITS = {
    "cpu": "% of a core",
    "memory": "MB",
    "ready": "s until every robot is heard",
    "recorded": "messages/s",
    "missing": "% of what was sent",
}


# `aucamp record`, without the channels for viewers
RECORDER = """
import sys
from pathlib import Path
from agent.ground.observe import record_fleets
from agent.process.command import complain
from agent.process.launch import until_signal
out, *paths = map(Path, sys.argv[1:])
with until_signal() as stop:
    record_fleets(paths, out, stop, complain, views=False)
"""


def measured(count: int, secured: bool) -> dict[str, float]:
    """One recorder of so many fleets, over COUNTED_S once all of them are heard."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = fleet_files(folder, count, secured)
        out = folder / "fleets" if count > 1 else folder / "fleet.mcap"
        files = [out / f"{path.stem}.mcap" for path in paths] if count > 1 else [out]
        talkers = python("-m", "tests.bench.network.talkers", *map(str, paths))
        time.sleep(5.0)  # until they listen: what is measured is the recorder's start, not theirs
        began_s = time.monotonic()
        recorder = python("-c", RECORDER, str(out), *map(str, paths))
        try:
            until(lambda: all(robots_in(active(file)) == ROBOTS for file in files), 120.0)
            ready_s = time.monotonic() - began_s
            cpu_s, wall_s = used_s(recorder.pid), time.monotonic()
            time.sleep(COUNTED_S)
            share = (used_s(recorder.pid) - cpu_s) / (time.monotonic() - wall_s)
            memory_mb = resident_mb(recorder.pid)
            recorder.send_signal(
                signal.SIGTERM
            )  # first, so that nothing that it records is cut short by the talkers' end
            recorder.communicate(timeout=60)
        finally:
            talkers.send_signal(signal.SIGTERM)
            talkers.communicate(timeout=60)
            recorder.kill()
            recorder.wait()
        kept, sent = counted(files)
    return {
        "cpu": 100.0 * share,
        "memory": memory_mb,
        "ready": ready_s,
        "recorded": kept / COUNTED_S,
        "missing": 100.0 * (sent - kept) / sent,
    }


def fleet_files(folder: Path, count: int, secured: bool) -> list[Path]:
    """So many fleets of ROBOTS, each with its own ports and keys."""
    ports = free_ports(count * ROBOTS)
    paths = []
    for k in range(count):
        fleet = demo_fleet(ROBOTS, "evidence", 0.0, 0, False, folder)
        robots = {
            name: msgspec.structs.replace(robot, listen=f"{'tls' if secured else 'tcp'}/127.0.0.1:{ports.pop()}")
            for name, robot in fleet.robot.items()
        }
        home = folder / f"lab{k}"
        home.mkdir()
        access = Access(keys="keys") if secured else Access()
        fleet = msgspec.structs.replace(fleet, fleet=f"tank{k}", robot=robots, access=access)
        if secured:
            make_all(fleet, home / "keys")
        paths.append(home / f"tank{k}.toml")
        paths[-1].write_text(dump(fleet), encoding="utf-8")
    return paths


def counted(files: list[Path]) -> tuple[int, int]:
    """Messages in the newest COUNTED_S of each file, and how many there would be by their running numbers."""
    kept = sent = 0
    for file in files:
        items = [item for item in read(file) if item.channel.startswith("/zenoh/") and "/alive/" not in item.channel]
        since_ns = max(item.log_time_ns for item in items) - round(COUNTED_S * 1e9)
        newest = [item for item in items if item.log_time_ns > since_ns]
        kept += len(newest)
        for channel in {item.channel for item in newest}:
            numbers = sorted(item.sequence for item in newest if item.channel == channel)
            step = min((b - a for a, b in pairwise(numbers)), default=1)
            sent += (numbers[-1] - numbers[0]) // step + 1
    return kept, sent


def robots_in(path: Path) -> int:
    """Whose states are in a recording so far."""
    if not path.exists():
        return 0
    return len({item.channel for item in read(path) if item.channel.startswith("/zenoh/") and "/state" in item.channel})


def active(path: Path) -> Path:
    return path.with_name(f"{path.name}.active")


def python(*words: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, *words]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def used_s(pid: int) -> float:
    """Processor time by Linux' /proc, of all threads."""
    words = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / TICK_HZ


def resident_mb(pid: int) -> float:
    (line,) = (s for s in Path(f"/proc/{pid}/status").read_text().splitlines() if s.startswith("VmRSS:"))
    return float(line.split()[1]) / 1024.0


if __name__ == "__main__":
    print(json.dumps(run(), indent=2))
