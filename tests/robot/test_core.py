"""Agent.step is a function of its inputs: the same bytes twice, in a fresh process, and under another hash seed."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from agent.core.codec import encode
from agent.core.step_io import Inputs
from agent.demo.demo import demo_fleet
from agent.robot.step import Agent
from tests.core.stepped_swarm import steps
from tests.network.scripted_agent import CALIBRATION
from tests.places import ROOT

DRIVER = "from tests.robot.test_core import run_hash; print(run_hash())"
FLEET = demo_fleet(3, "paper", 0.0, 0, False, Path("/nowhere"))


def run_hash() -> str:
    digest = hashlib.sha256()
    for _, inputs, outputs in steps(FLEET, 400):
        digest.update(encode(inputs))
        digest.update(encode(outputs))
    return digest.hexdigest()


@pytest.mark.parametrize("hash_seed", ["0", "4242"])
def test_same_bytes_in_a_fresh_process_with_another_hash_seed(hash_seed: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", DRIVER],
        cwd=ROOT,
        env={**os.environ, "PYTHONHASHSEED": hash_seed},
        capture_output=True,
        text=True,
        timeout=100,
        check=True,
    )
    assert done.stdout.strip() == run_hash()


def test_told_before_seen_and_all_agree() -> None:
    known: dict[str, list[str]] = {}
    last = {}
    for name, _, outputs in steps(FLEET, 900):
        if outputs.state:
            last[name] = outputs.state
            if known.setdefault(name, ["blind"])[-1] != outputs.state.knows:
                known[name].append(outputs.state.knows)
    assert known["r1"] == ["blind", "sees"]
    assert known["r2"] == known["r3"] == ["blind", "told", "sees"]
    for state in last.values():
        assert state.posterior_m == pytest.approx((0.76, 0.56, 0.07), abs=0.003)
        assert state.faults == ()


def test_silent_devices_are_named_within_a_second_and_talk_goes_on() -> None:
    agent = Agent(FLEET, "r1", CALIBRATION, incarnation=7)
    said = 0
    for step in range(20):
        outputs = agent.step(Inputs(), 10**18 + step * 50_000_000)
        said += len(outputs.says)
    assert agent.current.last_state is not None
    assert agent.current.last_state.faults == ("no frames", "no telemetry")
    assert said == 2 * 10
    assert msgspec.structs.asdict(outputs.set_point)["depth_m"] == 0.40
