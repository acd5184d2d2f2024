"""Three robots as processes, of which one hangs: the others answer at once, it is named, and stops when it wakes."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import dump
from agent.core.topics import ANSWER
from agent.ground.console import OrderConsole
from agent.process.transport import Observer
from tests.killing import killed_after
from tests.places import ROOT
from tests.waiting import until

FULL = {"r1": ("r2", "r3"), "r2": ("r1", "r3"), "r3": ("r1", "r2")}
PATIENCE_S = 120.0


@pytest.mark.slow
def test_a_stop_for_all_reaches_those_that_run(make_fleet, tmp_path: Path) -> None:
    fleet = make_fleet(FULL)
    own = {name: replace(r, serial=f"/dev/{name}", camera=f"v4l2:/dev/{name}") for name, r in fleet.robot.items()}
    fleet, path = replace(fleet, robot=own), tmp_path / "fleet.toml"  # on the system's clock: none waits for another
    path.write_text(dump(fleet))
    processes: dict[str, subprocess.Popen[bytes]] = {}
    with (
        killed_after(processes),
        OrderConsole(fleet, "ann") as ann,
        Observer(fleet, time.time_ns, (ANSWER,)) as observer,
    ):
        for name in fleet.robot:
            command = [sys.executable, "-m", "tests.network.scripted_agent", str(path), name, str(tmp_path)]
            processes[name] = subprocess.Popen(command, cwd=ROOT)
        until(lambda: len(ann.states()) == 3, PATIENCE_S)
        until(lambda: all(outcome.ok for outcome in ann.order(FULL, "stop").values()), PATIENCE_S)
        processes["r2"].send_signal(signal.SIGSTOP)
        outcomes = ann.order(FULL, "stop")
        assert outcomes["r1"].ok and outcomes["r3"].ok
        assert outcomes["r2"].answer is None and "did not answer within 1 s" in outcomes["r2"].why
        assert max(outcomes["r1"].took_s, outcomes["r3"].took_s) < outcomes["r2"].took_s
        observer.drain()
        processes["r2"].send_signal(signal.SIGCONT)
        woken: list[str] = []

        def answered() -> bool:
            woken.extend(item.chunks["robot"] for item in observer.drain())
            return "r2" in woken

        until(answered, PATIENCE_S)
        for process in processes.values():
            process.terminate()
            assert process.wait(PATIENCE_S) == 0
