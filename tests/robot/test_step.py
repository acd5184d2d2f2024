"""Agent.step is a function of its inputs: the same bytes twice, in a fresh process, and under another hash seed."""

import hashlib
import math
import os
import subprocess
import sys
from pathlib import Path

import msgspec
import pytest

from agent.core.codec import decode, encode
from agent.core.messages import Estimate, State
from agent.core.ranging.fix import Outline
from agent.core.ranging.sweep import Measurement
from agent.core.step_io import Heard, Inputs
from agent.demo.demo import demo_fleet
from agent.process.command import fleet_file
from agent.robot.fleet_reader import load_fleet
from agent.robot.step import Agent
from tests.core.stepped_swarm import START_NS, steps
from tests.network.scripted_agent import CALIBRATION
from tests.places import ROOT

DRIVER = "from tests.robot.test_step import run_hash; print(run_hash())"
FLEET = demo_fleet(3, "paper", 0.0, 0, False, Path("/nowhere"))


def run_hash() -> str:
    digest = hashlib.sha256()
    for _, inputs, outputs in steps(FLEET, 400):
        digest.update(encode(inputs))
        digest.update(encode(outputs))
    return digest.hexdigest()


def test_same_bytes_in_a_fresh_process_with_another_hash_seed() -> None:
    done = subprocess.run(
        [sys.executable, "-c", DRIVER],
        cwd=ROOT,
        env={**os.environ, "PYTHONHASHSEED": "4242"},
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


def test_a_camera_whose_timing_is_not_as_calibrated_is_named() -> None:
    agent = Agent(FLEET, "r1", CALIBRATION, incarnation=7)
    late = agent.measuring._late["ball"]
    for held, pace in ((None, 300.0), *[(60.0, 600.0)] * 5):  # frames are 60 ms late
        outline = Outline((320.0, 240.0), 60.0, 1.0, None)
        late.add(Measurement(1, 1, 400.0 + 0.06 * pace, 0.5, 60.0, held, outline, 0.99, pace), 0.5)
    outputs = agent.step(Inputs(), 10**18)
    text = "camera timing: sweeps show the lens 60 ms"
    assert any(fault.startswith(text) for fault in outputs.state.faults)
    assert any(line.text.startswith(text) and line.level == "warning" for line in outputs.log)


def test_silent_devices_are_named_within_a_second_and_talk_goes_on() -> None:
    agent = Agent(FLEET, "r1", CALIBRATION, incarnation=7)
    said = 0
    for step in range(20):
        outputs = agent.step(Inputs(), 10**18 + step * 50_000_000)
        said += len(outputs.says)
    assert agent.measuring.current.last_state is not None
    assert agent.measuring.current.last_state.faults == ("no frames", "no telemetry")
    assert said == 2 * 10
    assert msgspec.structs.asdict(outputs.set_point)["depth_m"] == 0.40


# --- targets ---
# Two targets, scripted steps: each has its own cache, estimator and valid set, and nothing passes between them.

WHERE_M = {"ball": (0.55, 0.66, 0.07), "buoy": (0.92, 0.45, 0.05)}
TARGETS_FLEET = load_fleet(fleet_file("two_balls"))


def swarm(
    seconds: float, visible: dict[str, set[str]], loss: set[str] = frozenset()
) -> dict[str, dict[str, list[State]]]:
    """Run r1 to r3 in virtual time; returns robot -> target -> states.

    `visible`: robot -> the targets that exist for its camera. `loss`: targets about which no message arrives.
    """
    seen = {robot: {t: x for t, x in WHERE_M.items() if t in names} for robot, names in visible.items()}
    shown: dict[str, dict[str, list[State]]] = {
        name: {target: [] for target in WHERE_M} for name in TARGETS_FLEET.robot
    }
    for name, _, outputs in steps(TARGETS_FLEET, round(seconds * 20), seen, lambda said: said.target not in loss):
        if outputs.state:
            shown[name][outputs.state.target].append(outputs.state)
    return shown


@pytest.fixture(scope="module")
def run() -> dict[str, dict[str, list[State]]]:
    """r3 has no buoy before its camera."""
    return swarm(40.0, {"r1": {"ball", "buoy"}, "r2": {"ball", "buoy"}, "r3": {"ball"}})


def test_all_find_both_and_who_never_saw_one_was_told(run) -> None:
    for robot, of_robot in run.items():
        for target, states in of_robot.items():
            assert math.dist(states[-1].posterior_m, WHERE_M[target]) < 0.002, (robot, target)
            told_only = (robot, target) == ("r3", "buoy")
            assert states[-1].knows == ("told" if told_only else "sees")
            assert (states[-1].acquired_t is None) == told_only
            assert states[-1].refused == {}


def test_each_target_has_its_own_valid_set_and_index(run) -> None:
    ball, buoy = (run["r1"][target][-1] for target in ("ball", "buoy"))
    assert {n.robot for n in ball.neighbours if n.valid} == {"r2", "r3"}
    assert {n.robot for n in buoy.neighbours if n.valid} == {"r2"}
    measured = [run["r1"][target][-1].measurements for target in WHERE_M]
    assert min(measured) >= 8, "the camera went from one to the other, several times"
    assert all(abs(a.t - b.t) <= 6 for a, b in zip(run["r1"]["ball"], run["r1"]["buoy"], strict=False))


def test_states_take_turns_and_count_for_themselves(run) -> None:
    for states in run["r2"].values():
        assert [state.seq for state in states] == list(range(1, len(states) + 1))
        assert len(states) == pytest.approx(200, abs=2)  # 5 Hz for each target


def test_what_is_said_of_one_target_does_not_reach_the_other() -> None:
    run = swarm(14.0, {name: {"ball"} for name in TARGETS_FLEET.robot}, loss={"buoy"})
    for of_robot in run.values():
        assert of_robot["ball"][-1].posterior_m is not None
        assert of_robot["buoy"][-1].posterior_m is None
        assert of_robot["buoy"][-1].knows == "blind"
        assert all(n.age_s is None for n in of_robot["buoy"][-1].neighbours)
        assert all(n.age_s is not None for n in of_robot["ball"][-1].neighbours)


def word(target: str, seq: int, x_m: tuple[float, float, float]) -> Heard:
    said = Estimate(
        fleet="tank", src="r2", dst="r1", incarnation=1, seq=seq, sent_ns=1, target=target, t=3, valid=True, x_m=x_m
    )
    return Heard(arrived_ns=START_NS, src="r2", payload=encode(said))


def test_an_unknown_target_is_refused_with_a_reason() -> None:
    agent = Agent(TARGETS_FLEET, "r1", CALIBRATION, incarnation=7)
    heard = (word("fish", 1, (0.5, 0.5, 0.1)), word("buoy", 1, (0.9, 0.4, 0.05)))
    outputs = agent.step(Inputs(heard=heard), START_NS)
    assert agent.inbox.refused == {"target": 1}
    assert [line.text for line in outputs.log] == [
        "refused from r2 (target): target 'fish' is not in our fleet file, which has ball, buoy; 1 so far"
    ]
    assert {name: p.cache.senders["r2"].heard for name, p in agent.targets.items()} == {"ball": 0, "buoy": 1}


def test_what_people_have_to_put_right_is_a_fault_for_ten_seconds() -> None:
    agent = Agent(TARGETS_FLEET, "r1", CALIBRATION, incarnation=7)
    other = Heard(arrived_ns=START_NS, src="r2", payload=b"\x80")
    refused = "r2: no schema, ours is 3"
    for heard, after_s, told in (((other,), 0, True), ((), 10, True), ((), 11, False)):
        outputs = agent.step(Inputs(heard=heard), START_NS + after_s * 10**9)
        assert outputs.state is not None and (refused in outputs.state.faults) is told


def test_the_order_of_messages_counts_for_each_target_alone() -> None:
    agent = Agent(TARGETS_FLEET, "r1", CALIBRATION, incarnation=7)
    place = (0.5, 0.5, 0.1)
    agent.step(Inputs(heard=(word("ball", 9, place), word("buoy", 4, place), word("buoy", 4, place))), START_NS)
    assert agent.inbox.refused == {"order": 1}


def test_each_neighbour_hears_about_each_target_with_one_number() -> None:
    agent = Agent(TARGETS_FLEET, "r1", CALIBRATION, incarnation=7)
    says = agent.step(Inputs(), START_NS).says
    assert sorted((said.dst, said.target, said.seq) for said in says) == [
        (dst, target, 1) for dst in ("r2", "r3") for target in ("ball", "buoy")
    ]
    assert all(decode(encode(said), Estimate) == said for said in says)
