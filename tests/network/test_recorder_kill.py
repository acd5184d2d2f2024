"""SIGKILL at random moments: the last second may be lost and nothing else, and what is left replays byte for byte.

Two moments by default; AUCAMP_KILLS=50 for the long version, and -s to see what was lost. On the wall: what dies is a
process, and what it loses is what the machine had not written.
"""

import os
import random
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from agent.core.config import Fleet, dump
from replay.check.check import check
from replay.files.channels import STEP_IN
from replay.files.log import read
from replay.files.recover import Recovered, recover
from tests.places import ROOT
from tests.waiting import until

KILLS = int(os.environ.get("AUCAMP_KILLS", "2"))
LOST_S = 1.0
AGENT = [sys.executable, "-m", "tests.network.scripted_agent"]

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120 + 60 * KILLS)]


def test_killed_agent_and_recorder(make_fleet: Callable[..., Fleet], tmp_path: Path) -> None:
    moments, lost = random.Random(), {"agent": [], "recorder": []}
    for number in range(KILLS):
        folder = tmp_path / str(number)
        folder.mkdir()
        lived_s = moments.uniform(0.3, 2.5)
        lost_s, results = one_run(make_fleet({"r1": ()}), folder, lived_s)
        for name, seconds in lost_s.items():
            lost[name].append(seconds)
            assert seconds < LOST_S, f"{name}, killed after {lived_s:.2f} s"
        for result in results.values():
            assert result.out is not None
            assert sum(result.messages.values()) == len(list(read(result.out)))
        assert [each.verdict for each in check([results["agent"].out]).results] == ["identical"]
    for name, seconds in lost.items():
        sys.stdout.write(f"{name}: lost at most {max(seconds):.2f} s, median {statistics.median(seconds):.2f} s\n")


def one_run(fleet: Fleet, folder: Path, lived_s: float) -> tuple[dict[str, float], dict[str, Recovered]]:
    """Start both, kill both once both have recorded for so long; how much of it is missing, and the mended files."""
    (folder / "fleet.toml").write_text(dump(fleet))
    record = [sys.executable, "-m", "agent", "record", str(folder / "fleet.toml"), "--out", str(folder / "fleet.mcap")]
    agent = [*AGENT, str(folder / "fleet.toml"), "r1", str(folder)]
    files = {"recorder": folder / "fleet.mcap.active", "agent": folder / "r1.mcap.active"}
    processes = {"recorder": subprocess.Popen(record, cwd=ROOT), "agent": subprocess.Popen(agent, cwd=ROOT)}
    killed_ns = {}
    try:
        until(lambda: all(path.exists() and newest_ns(path, name) for name, path in files.items()), timeout_s=120)
        time.sleep(lived_s)
        for name, process in processes.items():
            killed_ns[name] = time.time_ns()
            process.send_signal(signal.SIGKILL)
            process.wait(timeout=60)
    finally:
        for process in processes.values():
            process.kill()
            process.wait(timeout=60)
    results = {name: recover(path, force=True) for name, path in files.items()}
    lost_s = {name: (killed_ns[name] - newest_ns(path, name)) * 1e-9 for name, path in files.items()}
    return lost_s, results


def newest_ns(path: Path, name: str) -> int:
    """Log time of the newest step of an agent, or of the newest state that a recorder heard; 0: none yet."""
    wanted = STEP_IN.name if name == "agent" else "/zenoh/aucamp/test/robot/r1/state"
    times = [record.log_time_ns for record in read(path) if record.channel == wanted]
    return times[-1] if times else 0
