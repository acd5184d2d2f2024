"""Whole dives at other speeds, alone and beside busy processes: what the clock of a dive promises.

Minutes; run apart: python -m tests.bench clock. Fails where a dive does not pass or something in it came late.
"""

from __future__ import annotations

import contextlib
import json
import re
import statistics
import subprocess
import sys
import tempfile
import time
import timeit
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agent.clock.clock import RunClock
from agent.clock.keeper import start_clock
from hw.twin.physics.tank import TICK_NS
from replay.files.log import read
from tests.dive_timing import nothing_came_late, timing

LINKS = "/link/"  # in the channels of what robots say to each other
READS = 20_000
BUSY = 2  # processes that want a whole core each


class Case(NamedTuple):
    robots: int
    speed: str
    busy: int


CASES = (
    Case(3, "1", 0),
    Case(3, "1", BUSY),
    Case(5, "1", BUSY),
    Case(3, "max", 0),
    Case(5, "max", 0),
    Case(3, "max", BUSY),
    Case(3, "0.25", 0),
)


def run() -> dict[str, dict[str, Any]]:
    rows = reading()
    for case in CASES:
        rows |= dived(case)
    return rows


def reading() -> dict[str, dict[str, Any]]:
    """What it costs to ask a dive's clock for the time."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "clock"
        keeper = start_clock(path, ["r1"], time.time_ns(), 1.0, TICK_NS)
        clock = RunClock(path)
        took_s, systems_s = (
            statistics.median(timeit.repeat(ask, number=READS, repeat=7)) / READS
            for ask in (clock.now_ns, time.time_ns)
        )
        keeper.close()
    against = f"time.time_ns, {1e6 * systems_s:.2f} us"
    return {
        "reading a dive's clock": {"value": 1e6 * took_s, "unit": "us", "against": against, "ratio": took_s / systems_s}
    }


def dived(case: Case) -> dict[str, dict[str, Any]]:
    """How fast one dive went, how wrong it is, what came latest. Raises RuntimeError or AssertionError where it
    broke a promise."""
    name = f"dive of {case.robots}, --speed {case.speed}" + (
        f", beside {case.busy} busy processes" if case.busy else ""
    )
    with tempfile.TemporaryDirectory() as folder, busy(case.busy):
        out = Path(folder) / "run"
        command = [sys.executable, "-m", "agent", "demo", "--robots", str(case.robots), "--speed", case.speed]
        began_s = time.monotonic()
        done = subprocess.run([*command, "--out", str(out)], capture_output=True, text=True)
        wall_s = time.monotonic() - began_s
        if done.returncode != 0:
            raise RuntimeError(f"{name}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
        worst = max(row["relative_error_percent"] for row in summary["agents"].values())
        timings = {robot: timing(out / f"{robot}.mcap") for robot in summary["agents"]}
        log = (out / "logs" / "twin.log").read_text(encoding="utf-8")
        told = log.splitlines()[-1]
        found = re.search(r"([\d.]+) s of dive in ([\d.]+) s, ([\d.]+) times real time", told)
        assert found is not None, told
        nothing_came_late(log, *(out / f"{robot}.mcap" for robot in timings))
        step_s = max(t.step_gap_s for t in timings.values())
        usual_s, longest_s = message_s(out / "fleet.mcap")
    print(f"{name}: {told}; {timings}", file=sys.stderr)
    return {
        name: {"value": float(found[3]), "unit": f"s of dive a second ({found[1]} s in {found[2]} s)"},
        f"{name}: all of it": {"value": wall_s, "unit": "s on the wall, calibration and report included"},
        f"{name}: worst robot": {"value": worst, "unit": "% off, 0.4 allowed"},
        f"{name}: latest step": {"value": 1e3 * step_s, "unit": "ms after the one before, 50 by design"},
        f"{name}: longest silence": {
            "value": 1e3 * max(t.silence_s for t in timings.values()),
            "unit": "ms between telemetry, 20 by design",
        },
        f"{name}: messages": {
            "value": 1e3 * usual_s,
            "unit": f"ms of run time from a robot to the recorder, median ({1e3 * longest_s:.0f} ms: 99.9 %)",
        },
        f"{name}: slowest sweep": {
            "value": max(t.sweep_gap_frames for t in timings.values()),
            "unit": "frames of the sensor from one lens position to the next",
        },
    }


def message_s(fleet_file: Path) -> tuple[float, float]:
    """How long messages between robots were on their way, in run time: the median, and what one in a thousand takes."""
    found = [r.log_time_ns - r.publish_time_ns for r in read(fleet_file) if LINKS in r.channel]
    usual_ns, longest_ns = np.percentile(found, [50.0, 99.9])
    return usual_ns * 1e-9, longest_ns * 1e-9


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that do nothing but keep a core from others."""
    processes = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.wait()
