"""Whole dives at other speeds, alone and beside busy processes: what the clock of a dive promises.

Minutes; run apart: python -m tests.bench clock. Fails where a dive does not pass or something in it came late.
"""

from __future__ import annotations

import contextlib
import json
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from tests.dive_timing import nothing_came_late, timing

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
    rows: dict[str, dict[str, Any]] = {}
    for case in CASES:
        rows |= dived(case)
    return rows


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
        f"{name}: slowest sweep": {
            "value": max(t.sweep_gap_frames for t in timings.values()),
            "unit": "frames of the sensor from one lens position to the next",
        },
    }


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
