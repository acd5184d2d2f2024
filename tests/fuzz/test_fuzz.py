"""Seconds of what `make fuzz` does for as long as one likes, with fixed seeds; and every fault that was found once."""

from __future__ import annotations

import time
from pathlib import Path
from random import Random

import msgpack
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from agent.core.codec import Refusal, decode
from agent.core.config import Protocol
from agent.core.messages import Estimate, State
from tests.fuzz import cases, decoding, mutate, parts
from tests.fuzz.__main__ import main as fuzz
from tests.fuzz.decoder import Decoder, bytes_for
from tests.fuzz.decoders import decoders
from tests.fuzz.kernel import episode
from tests.fuzz.kernel.episode import Plan, play
from tests.fuzz.kernel.search import Fuzzer, again, scenes
from tests.fuzz.kernel.sizes import largest
from tests.fuzz.kernel.swarm import Robot, Scene
from tests.fuzz.shrink import shrink
from tests.fuzz.values import of_type

CASES = sorted(cases.FOLDER.glob("*.json"))
SEED = 15
MESSAGES = 400  # to the kernel of each protocol
PAYLOADS = 100  # to each decoder
SHORT_S = 14.0  # of a recorded dive: all robots see the target at its end
PLAN = Plan(Scene("paper", seconds=SHORT_S), "r2", 160, 40, ("r1",), silent=False, quiet=False)


@pytest.mark.parametrize("protocol", ["paper", "metropolis", pytest.param("evidence", marks=pytest.mark.slow)])
def test_no_message_stops_a_kernel_or_breaks_its_promises(protocol: Protocol) -> None:
    said: list[str] = []
    fuzzer = Fuzzer(SEED, said.append, keep=False)
    fuzzer.run(scenes(protocol, SHORT_S), MESSAGES)
    assert fuzzer.messages >= MESSAGES
    assert not said


def test_no_bytes_break_a_decoder() -> None:
    said: list[str] = []
    assert decoding.run(PAYLOADS, SEED, said.append, keep=False) == ({}, PAYLOADS), said


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_what_was_found_once_stays_mended(path: Path) -> None:
    case = cases.read(path)
    if case["part"] == "kernel":
        assert not [fault.name for _, fault in play(case["plan"], again(case["told"]))]
    else:
        decoder = next(each for each in decoders() if each.name == case["part"])
        with decoding.mute():
            assert decoding.broken(decoder, case["bytes"]) is None


# --- the fuzzer itself: a fault that is put in is found, made small and kept --------------------------------------


def test_a_planted_fault_is_found_made_small_and_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A robot that cannot bear a neighbour which names no covariance."""
    sound = Robot.step

    def step(self: Robot, heard: tuple) -> object:
        outputs = sound(self, heard)
        said = [sender.newest.message for sender in cache(self).senders.values() if sender.newest]
        assert_covariances(said)
        return outputs

    monkeypatch.setattr(Robot, "step", step)
    monkeypatch.setattr(episode, "crash", lambda error: episode.Broken(str(error), ""))
    monkeypatch.setattr(cases, "FOLDER", tmp_path)
    said: list[str] = []
    fuzzer = Fuzzer(SEED, said.append, keep=True)
    fuzzer.run([Scene("paper", seconds=SHORT_S)], MESSAGES)
    assert list(fuzzer.found) == ["paper: no covariance"]
    (path,) = tmp_path.iterdir()
    case = cases.read(path)
    assert len(case["told"]) == 1
    assert [fault.name for _, fault in play(case["plan"], again(case["told"]))] == ["no covariance"]
    monkeypatch.undo()
    assert not list(play(case["plan"], again(case["told"])))


def cache(robot: Robot):
    return robot.agent.targets["ball"].cache


def assert_covariances(said: list[Estimate]) -> None:
    if any(estimate.x_m is not None and estimate.cov_m2 is None for estimate in said):
        raise ValueError("no covariance")


def test_a_robot_that_leaves_its_depth_or_its_tank_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    sound = Robot.step

    def step(self: Robot, heard: tuple) -> object:
        outputs = sound(self, heard)
        says = tuple(replace(said, x_m=(99.0, 0.0, 0.0), cov_m2=(-1.0,) + 5 * (0.0,)) for said in outputs.says)
        return replace(outputs, says=says, set_point=replace(outputs.set_point, depth_m=0.0))

    monkeypatch.setattr(Robot, "step", step)
    assert {fault.name for _, fault in play(PLAN, again([]))} == {"depth", "place", "covariance"}


def test_a_robot_that_hears_a_neighbour_no_more_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    sound = Robot.step
    monkeypatch.setattr(Robot, "step", lambda self, heard: sound(self, tuple(h for h in heard if h.src != "r3")))
    plan = PLAN._replace(scene=Scene("paper", seconds=24.0), quiet=True)
    assert {fault.name for _, fault in play(plan, again([]))} == {"silenced"}


def test_an_honest_dive_breaks_nothing() -> None:
    for scene in (Scene("evidence", seconds=SHORT_S), Scene("evidence", keys=True, seconds=SHORT_S)):
        assert not list(play(PLAN._replace(scene=scene, steps=100), again([])))


def test_a_decoder_that_raises_is_found_with_few_bytes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def take(payload: bytes) -> None:
        if b"\x07" in payload:
            raise KeyError("seven")

    monkeypatch.setattr(decoding, "decoders", lambda: (Decoder("planted", take, lambda rng: rng.randbytes(20)),))
    monkeypatch.setattr(decoding, "crash", lambda error: episode.Broken("KeyError", str(error)))
    monkeypatch.setattr(cases, "FOLDER", tmp_path)
    said: list[str] = []
    assert set(decoding.run(500, SEED, said.append)[0]) == {"planted: KeyError"}
    (path,) = tmp_path.iterdir()
    assert cases.read(path)["bytes"] == b"\x07"


def test_what_is_slow_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    slow = Decoder(
        "planted",
        lambda payload: sum(range(10_000_000)) if payload == b"slow" else None,
        lambda rng: b"slow",
        slow_s=0.01,
    )
    monkeypatch.setattr(decoding, "decoders", lambda: (slow,))
    assert "planted: slow" in decoding.run(3, SEED, lambda line: None, keep=False)[0]


# --- its pieces ---------------------------------------------------------------------------------------------------


@settings(deadline=None, derandomize=True, database=None)
@given(st.lists(st.integers(0, 9), min_size=1, max_size=60), st.integers(0, 9))
def test_shrinking_leaves_what_is_needed(parts_: list[int], needed: int) -> None:
    small = shrink(parts_, lambda some: needed in some, 400)
    assert small == ([needed] if needed in parts_ else parts_)


@settings(deadline=None, derandomize=True, database=None)
@given(st.integers(0, 2**32))
def test_generators_give_bytes_and_the_same_again(seed: int) -> None:
    for kind in (Estimate, State):
        plain = of_type(kind, Random(seed), 0.0)
        assert of_type(kind, Random(seed), 0.0) == plain
        payload = msgpack.packb(plain)
        assert mutate.raw(payload, Random(seed)) == mutate.raw(payload, Random(seed))
    assert mutate.bomb(Random(seed)) == mutate.bomb(Random(seed))


def test_half_of_what_a_decoder_gets_is_not_what_it_was_made_for() -> None:
    codec = next(each for each in decoders() if each.name == "codec.Estimate")
    rng, pool, refused = Random(SEED), [], 0
    for _ in range(400):
        payload = bytes_for(codec, pool, rng)
        try:
            refused += decode(payload, Estimate) is None
        except Refusal:
            refused += 1
    assert 100 < refused < 380


def test_the_longest_container_is_found_wherever_it_is() -> None:
    class Deep:
        def __init__(self) -> None:
            self.rows = {"a": [{"b": (1, 2, [0] * 77)}]}

    assert largest(Deep()) == (77, "Deep.rows[...][...][...][...]")


def test_parts_take_turns_and_count(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [part(1, lambda line: None, False).name for part in parts.chosen("all", None)]
    assert names[:3] == ["kernel paper", "kernel metropolis", "kernel evidence"]
    assert {"decoders", "wire", "firmware", "recordings"} <= set(names)
    (paper,) = (part(1, lambda line: None, False) for part in parts.chosen("kernel", "paper"))
    monkeypatch.setattr(parts, "scenes", lambda protocol: [PLAN.scene])
    paper._scenes = [PLAN.scene]
    paper.turn(200, time.monotonic() + 60.0)
    assert paper.done >= 200
    assert paper.rate() > 0.0


def test_a_name_that_is_none_is_one_line_and_fuzzes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        fuzz("decoders", only=["page", "nope"], list_=False)
    said = capsys.readouterr()
    assert ended.value.code == 2 and not said.out and said.err.count("\n") == 1
    assert said.err.startswith("fuzz: --only nope: no decoder begins so; choose from codec.Answer, ")
    assert parts.refused("wire", ["request"]) == "wire takes no --only; leave it out"
    assert parts.refused("all", ["page", "fleet"]) == parts.refused("wire", ()) == ""
