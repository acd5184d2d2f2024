"""The net under a step: what breaks is undone, found, left out and told, and the robot holds its depth."""

import pickle

import pytest
from msgspec.structs import replace

from agent.core.codec import encode
from agent.core.messages import State
from agent.core.step_io import Heard, Inputs
from agent.core.step_transaction import SAVE_EVERY, SURFACE_AFTER, SURFACE_M, Savepoint
from agent.process.command import shipped_fleet
from agent.robot.fleet_reader import load_fleet
from agent.robot.inbox import Inbox
from agent.robot.step import Agent
from agent.robot.targets import Targets
from tests.core.swarm_on_hand import Swarm
from tests.network.scripted_agent import CALIBRATION

POISON = b"poison"


@pytest.fixture(params=["paper", "metropolis", "evidence"])
def swarm(request) -> Swarm:
    """Three robots that have known each other for a while."""
    swarm = Swarm(request.param)
    swarm.run(4.0)
    return swarm


def poisoned(agent: Agent, monkeypatch: pytest.MonkeyPatch, payload: bytes = POISON) -> None:
    """A kernel with a fault: one payload breaks it, after it has changed things."""
    take = Inbox._take

    def broken(inbox, item, status, now_ns) -> None:
        if inbox is agent.inbox and item.payload == payload:
            agent.inbox.refused["half done"] = 1
            agent.measuring.current.estimator.t += 1000
            raise KeyError("r9")
        take(inbox, item, status, now_ns)

    monkeypatch.setattr(Inbox, "_take", broken)  # of an object it would be undone with the step


def heard(src: str, payload: bytes, now_ns: int) -> Heard:
    return Heard(arrived_ns=now_ns, src=src, payload=payload)


def test_a_savepoint_brings_everything_back(swarm) -> None:
    agent, now_ns = swarm.agents["r1"], swarm.now_ns
    before, point = pickle.dumps(agent), Savepoint(agent)
    for _ in range(40):
        swarm.step()
    assert pickle.dumps(agent) != before
    point.restore()
    again = pickle.loads(before)
    ours, theirs = agent.step(Inputs(), now_ns + 10**9), again.step(Inputs(), now_ns + 10**9)
    assert encode(ours) == encode(theirs)


def test_one_message_that_breaks_a_step_is_left_out_and_the_others_count(swarm, monkeypatch) -> None:
    while not (mail := swarm.mail("r1")):
        swarm.step()
    agent, now_ns = swarm.agents["r1"], swarm.now_ns + 10**6
    twin = pickle.loads(pickle.dumps(agent))
    poisoned(agent, monkeypatch)
    ours = agent.step(Inputs(heard=(*mail[:1], heard("r2", POISON, now_ns), *mail[1:])), now_ns)
    theirs = twin.step(Inputs(heard=mail), now_ns)
    assert ours.says == theirs.says
    assert agent.measuring.current.estimator.t == twin.measuring.current.estimator.t
    assert "half done" not in agent.inbox.refused
    state = swarm.state("r1")
    assert state.mode == "degraded"
    assert any("KeyError" in fault and "r2" in fault for fault in state.faults)
    assert agent.transaction.fault(now_ns + 60 * 10**9) is None


def test_a_payload_that_broke_a_step_is_not_taken_in_again(swarm, monkeypatch) -> None:
    agent = swarm.agents["r1"]
    poisoned(agent, monkeypatch)
    agent.step(Inputs(heard=(heard("r2", POISON, swarm.now_ns),)), swarm.now_ns + 1)
    taken: list[bytes] = []
    monkeypatch.setattr(Inbox, "_take", lambda inbox, item, status, now_ns: taken.append(item.payload))
    agent.step(Inputs(heard=(heard("r3", POISON, swarm.now_ns), heard("r3", b"other", swarm.now_ns))), swarm.now_ns + 2)
    assert taken == [b"other"]


def test_a_kernel_that_breaks_whatever_it_is_told_holds_its_depth_then_goes_up(swarm, monkeypatch) -> None:
    agent, now_ns = swarm.agents["r1"], swarm.now_ns
    sound = agent.step(Inputs(), now_ns + 1).set_point

    def broken(*about: object) -> None:
        raise RecursionError

    monkeypatch.setattr(Targets, "iterate", broken)
    depths, states, log = [], [], []
    for k in range(2 * SURFACE_AFTER):
        outputs = agent.step(Inputs(), now_ns + 2 + k * 50_000_000)
        depths.append(outputs.set_point.depth_m)
        states.append(outputs.state)
        log += [(line.level, line.text) for line in outputs.log]
    assert depths[: SURFACE_AFTER - 1] == [sound.depth_m] * (SURFACE_AFTER - 1)
    assert set(depths[SURFACE_AFTER - 1 :]) == {SURFACE_M}
    assert all(s.mode == "degraded" and "RecursionError" in s.faults[0] for s in states if s is not None)
    assert any(isinstance(s, State) for s in states)
    assert log == [("error", "degraded: RecursionError, in a step whose inputs were left out")]
    monkeypatch.undo()
    outputs = agent.step(Inputs(), now_ns + 10 * 10**9)
    assert outputs.set_point.depth_m == sound.depth_m, "and back, when it works again"


def test_one_that_breaks_from_its_first_step_on_shows_why(monkeypatch) -> None:
    start_ns = 10**18
    agent = Agent(load_fleet(shipped_fleet("tank")), "r1", CALIBRATION, start_ns)
    monkeypatch.setattr(Targets, "iterate", lambda *about: 1 / 0)
    outputs = [agent.step(Inputs(), start_ns + k * 50_000_000) for k in range(1, 40)]
    states = [each.state for each in outputs if each.state is not None]
    assert len(states) == 10 and [state.seq for state in states] == list(range(1, 11))
    assert all(state.mode == "degraded" and "ZeroDivisionError" in state.faults[0] for state in states)
    assert "ZeroDivisionError" in outputs[0].log[0].text


def test_keys_told_in_a_step_that_came_to_nothing_are_told_again(swarm, monkeypatch) -> None:
    agent, now_ns = swarm.agents["r1"], swarm.now_ns
    keys = {"r2": bytes(32)}
    monkeypatch.setattr(Targets, "iterate", lambda *about: 1 / 0)
    agent.step(Inputs(keys=keys), now_ns + 1)
    monkeypatch.undo()
    told: list[dict] = []
    for target in agent.targets.values():
        monkeypatch.setattr(type(target.estimator), "trust", lambda estimator, keys: told.append(keys))
    agent.step(Inputs(), now_ns + 2)
    agent.step(Inputs(), now_ns + 3)
    assert told == [keys]


def test_the_same_breaks_give_the_same_bytes(swarm, monkeypatch) -> None:
    agent, twin = swarm.agents["r1"], pickle.loads(pickle.dumps(swarm.agents["r1"]))
    poisoned(agent, monkeypatch)
    poisoned(twin, monkeypatch)
    now_ns = swarm.now_ns + 10**6
    for k in range(10):
        inputs = Inputs(heard=(heard("r2", POISON if k % 3 else b"x", now_ns + k),))
        ours, theirs = (each.step(replace(inputs), now_ns + k * 50_000_000 + 1) for each in (agent, twin))
        assert encode(ours) == encode(theirs)


def test_a_step_that_breaks_long_after_the_savepoint_is_undone_alone(swarm, monkeypatch) -> None:
    """What it knew before the step it knows again, by the inputs since the savepoint; orders are not set off again."""
    agent, twin = swarm.agents["r1"], pickle.loads(pickle.dumps(swarm.agents["r1"]))
    poisoned(agent, monkeypatch)
    for k in range(3 * SAVE_EVERY):
        now_ns = swarm.now_ns + k * 50_000_000 + 1
        word = heard("r2", POISON, now_ns - 1)
        ours = agent.step(Inputs(heard=(word,) if k == SAVE_EVERY + 7 else ()), now_ns)
        theirs = twin.step(Inputs(), now_ns)
        assert ours.says == theirs.says and ours.set_point == theirs.set_point
    assert agent.measuring.current.estimator.t == twin.measuring.current.estimator.t
