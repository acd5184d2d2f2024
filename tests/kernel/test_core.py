"""Agent.step is a function of its inputs: the same bytes twice, in a fresh process, and under another hash seed."""

import hashlib
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

HERE = Path(__file__).parent
DRIVER = """
import sys; sys.path[:0] = [{network!r}, {here!r}]
import test_core
print(test_core.run_hash())
"""


def scripted_run(steps: int = 400):
    """Three agents whose messages reach each other as bytes; yields robot, outputs."""
    sys.path.insert(0, str(HERE.parent / "network"))
    from scripted_agent import CALIBRATION, Motors, Script

    from agent.core import Agent
    from agent.demo import demo_fleet
    from agent.messages import Heard, Inputs, encode

    fleet = demo_fleet(3, "paper", 0.0, 0, False, Path("/nowhere"))
    now = [10**18]
    agents = {n: Agent(fleet, n, CALIBRATION, incarnation=7) for n in fleet.robot}
    scripts = {n: Script(fleet, n, lambda: now[0]) for n in fleet.robot}
    motors = {n: Motors(s) for n, s in scripts.items()}
    post: dict[str, list[Heard]] = {n: [] for n in agents}
    for _ in range(steps):
        now[0] += 50_000_000
        for name, agent in agents.items():
            telemetry, _ = motors[name].drain()
            inputs = Inputs(telemetry=tuple(telemetry), sightings=tuple(scripts[name].drain()), heard=tuple(post[name]))
            post[name] = []
            outputs = agent.step(inputs, now[0])
            motors[name].send(outputs.set_point, now[0])
            if outputs.sweep:
                scripts[name].plan(outputs.sweep)
            for e in outputs.says:
                post[e.dst].append(Heard(arrived_ns=now[0], src=name, payload=encode(e)))
            yield name, inputs, outputs


def run_hash() -> str:
    from agent.messages import encode

    digest = hashlib.sha256()
    for _, inputs, outputs in scripted_run():
        digest.update(encode(inputs))
        digest.update(encode(outputs))
    return digest.hexdigest()


@pytest.mark.parametrize("hash_seed", ["0", "4242"])
def test_same_bytes_in_a_fresh_process_with_another_hash_seed(hash_seed: str) -> None:
    code = DRIVER.format(network=str(HERE.parent / "network"), here=str(HERE))
    done = subprocess.run(
        [sys.executable, "-c", code],
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
    for name, _, outputs in scripted_run(900):
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
    from agent.messages import Inputs

    sys.path.insert(0, str(HERE.parent / "network"))
    from scripted_agent import CALIBRATION

    from agent.core import Agent
    from agent.demo import demo_fleet

    agent = Agent(demo_fleet(3, "paper", 0.0, 0, False, Path("/nowhere")), "r1", CALIBRATION, incarnation=7)
    said = 0
    for step in range(20):
        outputs = agent.step(Inputs(), 10**18 + step * 50_000_000)
        said += len(outputs.says)
    assert agent.pursuit.last_state is not None
    assert agent.pursuit.last_state.faults == ("no frames", "no telemetry")
    assert said == 2 * 10
    assert msgspec.structs.asdict(outputs.set_point)["depth_m"] == 0.40
