"""Three robots in a chain, each with the real loop, kernel, keys and recording, on one clock of ours; r2 relays.

Recordings are as the kernel gave them, links carry what was signed, and a replay needs no private key.
"""

import base64
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec import UNSET
from msgspec.structs import replace

from agent.core.capability_messages import Keyframe
from agent.core.codec import decode, encode
from agent.core.config import Access, Fleet, dump
from agent.core.messages import Entry, Estimate
from agent.core.step_io import Heard, Inputs, Outputs, Said
from agent.core.topics import KEYFRAME
from agent.core.trust import entry_bytes, verify_signature
from agent.demo.demo import demo_fleet
from agent.ground.new_fleet import make_keys
from agent.process.agent_process import STEP_NS, Runtime, run_facts
from agent.process.keys import read_public, robot_keys, signing
from agent.robot.step import Agent
from replay.check.check import as_said, check
from replay.files.channels import STEP_IN, STEP_OUT
from replay.files.log import LogWriter, info, read
from replay.recorder import BlackBoxWriter
from tests.capabilities.survey.frames import drawn_frames
from tests.network.scripted_agent import CALIBRATION, Motors, Script
from tests.process.said import FOREIGN, entry, proposal, said, sample

CHAIN = {"r1": ("r2",), "r2": ("r1", "r3"), "r3": ("r2",)}
START_NS = 1_767_225_600_000_000_000
STEPS, KEY_GOES = 240, 200  # steps: twelve seconds, and when the public key of r3 is removed


class Clock:
    now_ns = START_NS

    def __call__(self) -> int:
        return self.now_ns


class Now(NamedTuple):
    """What the loop wants of a clock."""

    clock: Clock

    def now_ns(self) -> int:
        return self.clock()


class Wire:
    """A robot's end of the links: bytes arrive one step later."""

    def __init__(self, ends: dict[str, "Wire"], clock: Clock) -> None:
        self.ends, self.clock = ends, clock
        self.inbox: deque[Heard] = deque()
        self.sent: list[Estimate] = []

    def drain(self):
        heard = tuple(self.inbox)
        self.inbox.clear()
        return heard, ()

    def orders(self):
        return ()

    def say(self, estimate: Estimate) -> None:
        self.sent.append(estimate)
        heard = Heard(arrived_ns=self.clock(), src=estimate.src, payload=encode(estimate))
        self.ends[estimate.dst].inbox.append(heard)

    def show(self, message) -> None:
        pass


class Run(NamedTuple):
    folder: Path
    keys: dict[str, bytes]  # public, all that there were
    sent: dict[str, list[Estimate]]


def chain(folder: Path) -> Fleet:
    fleet = demo_fleet(3, "evidence", 0.0, 0, False, folder)
    robots = {name: replace(robot, neighbours=CHAIN[name]) for name, robot in fleet.robot.items()}
    return replace(fleet, robot=robots, access=Access(keys="keys"))


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    folder = tmp_path_factory.mktemp("signed")
    fleet, path = chain(folder), folder / "fleet.toml"
    make_keys(fleet.robot, folder / "keys")
    public = {name: read_public(folder / "keys" / f"{name}.sign.pub") for name in fleet.robot}
    clock, ends, loops = Clock(), {}, {}
    (folder / "logs").mkdir()
    with pytest.MonkeyPatch.context() as patch, ExitStack() as stack:
        patch.delenv("AUCAMP_KEYS", raising=False)
        for name in fleet.robot:
            keys = robot_keys(fleet, name, path)
            script = Script(fleet, name, clock)
            script.idle_ns = START_NS
            attachments = {"fleet.toml": dump(fleet), "calibration.toml": dump(CALIBRATION)}
            facts = run_facts(fleet, name, START_NS)
            log = stack.enter_context(LogWriter(folder / "logs" / f"{name}.mcap", facts, attachments))
            ends[name] = Wire(ends, clock)
            loops[name] = Runtime(
                name,
                Agent(fleet, name, CALIBRATION, START_NS),
                script,
                Motors(script),
                ends[name],
                BlackBoxWriter(log, name, clock).step,
                Now(clock),
                sign=keys.sign,
                keys=keys.changed,
            )
        for number in range(STEPS):
            if number == KEY_GOES:
                (folder / "keys" / "r3.sign.pub").unlink()
            for loop in loops.values():
                loop.step(number)
            clock.now_ns += STEP_NS
    return Run(folder / "logs", public, {name: end.sent for name, end in ends.items()})


def steps(run: Run, robot: str, channel: str, kind):
    return [decode(r.data, kind, limit=1 << 20) for r in read(run.folder / f"{robot}.mcap") if r.channel == channel]


def entries(estimates: list[Estimate]) -> list[tuple[Estimate, Entry]]:
    return [(estimate, entry) for estimate in estimates if estimate.gossip for entry in estimate.gossip.entries]


@pytest.mark.parametrize("robot", CHAIN)
def test_it_is_logged_unsigned_and_sent_signed(run: Run, robot: str) -> None:
    logged = [estimate for outputs in steps(run, robot, STEP_OUT.name, Outputs) for estimate in outputs.says]
    own = [one for _, one in entries(logged) if one.origin == robot]
    assert own and all(one.signature == b"" for one in own)
    sent = [(estimate, one) for estimate, one in entries(run.sent[robot]) if one.origin == robot]
    assert len(sent) == len(own)
    assert all(genuine(run, estimate, one) for estimate, one in sent)


def test_what_comes_by_a_relay_has_the_signature_of_its_origin(run: Run) -> None:
    heard = [decode(h.payload, Estimate) for inputs in steps(run, "r3", STEP_IN.name, Inputs) for h in inputs.heard]
    relayed = [(estimate, one) for estimate, one in entries(heard) if one.origin == "r1"]
    assert relayed and {estimate.src for estimate, _ in relayed} == {"r2"}
    assert all(genuine(run, estimate, one) for estimate, one in relayed)


def genuine(run: Run, estimate: Estimate, one: Entry) -> bool:
    signed = entry_bytes(estimate.fleet, estimate.target, estimate.gossip.epoch, one)
    return verify_signature(run.keys[one.origin], one.signature, signed)


def test_all_keys_in_the_first_step_and_what_is_left_within_a_second_of_a_removal(run: Run) -> None:
    left = {name: key for name, key in run.keys.items() if name != "r3"}
    for robot in CHAIN:
        told = {n: i.keys for n, i in enumerate(steps(run, robot, STEP_IN.name, Inputs)) if i.keys is not UNSET}
        assert list(told.values()) == [run.keys, left]
        first, second = told
        assert first == 0 and 0 <= second - KEY_GOES <= 20


def test_no_recording_holds_a_private_key_or_says_where_keys_are(run: Run) -> None:
    keys = run.folder.parent / "keys"
    text = [(keys / f"{name}.sign").read_bytes().splitlines()[1] for name in CHAIN]
    private = [*text, *(base64.b64decode(line)[-32:] for line in text)]  # as it lies in the file, and bare
    for robot in CHAIN:
        file = run.folder / f"{robot}.mcap"
        recorded = [record.data for record in read(file)] + [t.encode() for t in info(file).attachments.values()]
        assert any(run.keys[robot] in data for data in recorded), "it holds the public ones"
        assert not any(key in data for key in private for data in recorded)
        assert not any(str(keys).encode() in data for data in recorded)
        assert 'keys = "keys"' in info(file).attachments["fleet.toml"]


def test_the_replay_is_identical_and_what_was_heard_was_said(run: Run) -> None:
    checked = check([run.folder])
    assert checked.exit_code == 0 and checked.as_json()["identical"] is True
    (links,) = checked.links.values()
    assert {(link.src, link.dst) for link in links} == {(a, b) for a, names in CHAIN.items() for b in names}
    assert all(link.heard > 50 and link.unknown == 0 for link in links)


def test_a_forged_word_under_a_senders_name_is_not_one_that_it_said() -> None:
    """Only the signature is left out of the comparison, and only that of the sender's own word."""
    logged = said(entry(), entry("r3", signature=FOREIGN), sample(), proposal())
    sent = signing("r1", Ed25519PrivateKey.generate())(logged)
    assert as_said(encode(sent), "r1") == as_said(encode(logged), "r1") == encode(logged)
    first, relayed = sent.gossip.entries
    for forged in (
        (replace(first, count=9), relayed),
        (first, replace(relayed, signature=FOREIGN[::-1])),
        (first, replace(relayed, count=9)),
    ):
        heard = replace(sent, gossip=replace(sent.gossip, entries=forged))
        assert as_said(encode(heard), "r1") != encode(logged)
    for garbage in (b"", b"\xc1", b"\x81\xa6gossip\x95\x00\x01\x02\x03\x04", encode(logged)[:-3]):
        assert as_said(garbage, "r1") == garbage


def test_so_it_is_with_a_keyframe_and_one_that_is_passed_on_keeps_its_signature() -> None:
    frame = drawn_frames(3)[0]
    logged = Keyframe(fleet="survey", src="r1", dst="r2", incarnation=0, seq=1, sent_ns=7, frame=frame)
    outgoing = Said(topic=KEYFRAME.name, to="r2", payload=encode(logged))
    sent = signing("r1", Ed25519PrivateKey.generate())(outgoing).payload
    assert frame.origin == "r1" and sent != encode(logged)
    assert as_said(sent, "r1") == as_said(encode(logged), "r1") == encode(logged)
    forged = replace(decode(sent, Keyframe, KEYFRAME.limit), frame=replace(frame, number=9))
    assert as_said(encode(forged), "r1") != encode(logged)
    assert as_said(sent, "r2") == sent, "r2 passes it on as it came"
