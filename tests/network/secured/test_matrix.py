"""Every (certificate, receiver, key): who is believed what by whom, and who hears what of whom.

What is expected is spelled here a second time, from the keys alone; the rules themselves are router_config/settings.py.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import zenoh
from msgspec.structs import replace

from agent.core import topics
from agent.core.config import Fleet, Tank, dump
from agent.core.messages import Image, State
from agent.core.ranging.camera_model import Calibration
from agent.process.agent_process import OPEN, load_setup
from agent.process.keys import VARIABLE
from agent.process.transport import Transport
from replay.files.log import info
from router_config.settings import observer_config, peer_config, router_config
from tests.known_lens import CAMERA, PLAIN
from tests.network.conftest import unused_port
from tests.network.secured.conftest import Secured
from tests.network.secured.parties import (
    CHAIN,
    CONSOLES,
    STRANGER,
    Ear,
    client,
    listener,
    message_keys,
    opened,
    order_keys,
    say_everything,
    token_keys,
)
from tests.places import ROOT
from tests.waiting import until

pytestmark = pytest.mark.slow

CERTIFICATES = (*CHAIN, "recorder", *CONSOLES, STRANGER)
WATCHERS = ("recorder", "ann")
PAIRWISE = ("link", "near", "claim", "keyframe", "light")
SETTLED_S = 0.5  # after the last thing that should come, what should not would have come too

Triple = tuple[str, str, str]  # whose certificate, receiver, key


def triples(receiver: str) -> set[Triple]:
    """All that anybody could try on a receiver, as anybody else."""
    return {
        (by, receiver, key)
        for by in CERTIFICATES
        for key in (*message_keys(), *token_keys(by), *order_keys())
        if by != receiver
    }


def believed(by: str, receiver: str, key: str) -> bool:
    """Whether `receiver` should take from `by` what comes on a key."""
    _, _, kind, *rest = key.split("/")
    neighbour = receiver not in CHAIN or by in CHAIN[receiver]
    if kind in PAIRWISE:
        return by == rest[0] and neighbour and (receiver not in CHAIN or receiver == rest[1])
    if kind == "alive":
        return by == rest[0] and neighbour
    if kind == "twice":
        return by == rest[1] and neighbour
    if rest[1] == "order":
        return receiver in CHAIN and rest[0] in (receiver, "*") and by == rest[2]
    return by == rest[0] and receiver not in CHAIN


def come_through(ear: Ear, receiver: str, talkers: dict[str, zenoh.Session]) -> set[Triple]:
    """What a receiver takes when everybody says everything at once."""
    whose = {key: by for by in CERTIFICATES for key in token_keys(by)}
    kept = [say_everything(session, by) for by, session in talkers.items()]

    def found() -> set[Triple]:
        return {(whose[key] if who == "token" else who, receiver, key) for key, who in set(ear.heard)}

    with contextlib.suppress(AssertionError):
        until(lambda: found() >= {triple for triple in triples(receiver) if believed(*triple)}, 3.0)
    time.sleep(SETTLED_S)
    del kept
    return found()


def told_to_robot(fleet: Fleet, keys: Path, receiver: str, config: str) -> set[Triple]:
    """What a robot takes from those who dial it."""
    with contextlib.ExitStack() as stack:
        orders = topics.ORDER.format(fleet="test", robot=receiver, console="*")
        ear = Ear(stack.enter_context(opened(config)), orders=orders)
        where = fleet.robot[receiver].listen
        dialling = {by: client(where, keys, by) for by in CERTIFICATES if by != receiver}
        talkers = {by: stack.enter_context(opened(config)) for by, config in dialling.items()}
        return come_through(ear, receiver, talkers)


def told_to_watcher(fleet: Fleet, keys: Path, receiver: str, config: str) -> set[Triple]:
    """What an observer or a console takes from those who listen where it dials: all certificates, at any address."""
    ends = {by: f"tls/127.0.0.1:{unused_port()}" for by in CERTIFICATES if by != receiver}
    changed: dict[str, Any] = json.loads(config)
    changed["connect"]["endpoints"] = list(ends.values())
    with contextlib.ExitStack() as stack:
        talkers = {by: stack.enter_context(opened(listener(end, keys, by))) for by, end in ends.items()}
        ear = Ear(stack.enter_context(opened(json.dumps(changed))))
        for by in CHAIN:
            publisher = talkers[by].declare_publisher(f"aucamp/test/robot/{by}/state")
            until(lambda publisher=publisher: publisher.matching_status.matching)
        time.sleep(SETTLED_S)  # for those who are not to be linked, or linked and not heard
        return come_through(ear, receiver, talkers)


def test_each_certificate_is_believed_on_its_own_keys_and_on_no_other(secured: Secured) -> None:
    fleet, keys = secured
    tried: set[Triple] = set()
    for receiver in (*CHAIN, *WATCHERS):
        if receiver in CHAIN:
            found = told_to_robot(fleet, keys, receiver, peer_config(fleet, receiver, keys))
        else:
            found = told_to_watcher(fleet, keys, receiver, observer_config(fleet, receiver, keys))
        wanted = {triple for triple in triples(receiver) if believed(*triple)}
        assert found == wanted, (sorted(found - wanted), sorted(wanted - found))
        tried |= triples(receiver)
    assert len(tried) > 1000


def without_rules(config: str) -> str:
    changed: dict[str, Any] = json.loads(config)
    del changed["access_control"]
    return json.dumps(changed)


def test_without_the_rules_certificates_alone_keep_nobody_from_saying_anything(secured: Secured) -> None:
    """The test above can fail: links are the same, and everything comes through."""
    fleet, keys = secured
    for receiver, told, config in (
        ("r1", told_to_robot, peer_config(fleet, "r1", keys)),
        ("recorder", told_to_watcher, observer_config(fleet, "recorder", keys)),
    ):
        found = told(fleet, keys, receiver, without_rules(config))
        puts = {(by, to, key) for by, to, key in triples(receiver) if key in message_keys() and by in CHAIN}
        assert puts <= found


def test_each_certificate_hears_what_is_for_it_and_no_more(secured: Secured) -> None:
    """Robots hear what their neighbours have for them, observers and consoles everything, a stranger nothing."""
    fleet, keys = secured
    for speaker in ("r1", "r2"):
        with contextlib.ExitStack() as stack:
            session = stack.enter_context(opened(peer_config(fleet, speaker, keys)))
            ears = {}
            for by in CERTIFICATES:
                if by != speaker:
                    listening = stack.enter_context(opened(client(fleet.robot[speaker].listen, keys, by)))
                    ears[by] = Ear(listening, (topics.EVERY_FLEET, "aucamp/test/**", *message_keys()))
            for key in ("aucamp/test/robot/r1/state", f"aucamp/test/link/r1/{'r2' if speaker == 'r1' else 'r3'}"):
                publisher = session.declare_publisher(key)
                until(lambda publisher=publisher: publisher.matching_status.matching)
            time.sleep(SETTLED_S)
            kept = [session.put(key, "said") for key in message_keys()]
            kept.append(session.liveliness().declare_token(f"aucamp/test/alive/{speaker}/0"))
            time.sleep(SETTLED_S)
            for by, ear in ears.items():
                told = {key for key, _ in ear.heard}
                token = {f"aucamp/test/alive/{speaker}/0"}
                if by in ("recorder", *CONSOLES):
                    assert told == {*message_keys(), *token}, by
                elif by in CHAIN and by in CHAIN[speaker]:
                    mine = {key for key in message_keys() if key.split("/")[2] in PAIRWISE and key.endswith(f"/{by}")}
                    assert told == mine | token, by
                else:
                    assert told == set(), by


def test_behind_the_router_observers_hear_everything_and_nobody_says_anything(secured: Secured) -> None:
    fleet, keys = secured
    where = f"tls/127.0.0.1:{unused_port()}"
    with contextlib.ExitStack() as stack:
        r1 = stack.enter_context(opened(peer_config(fleet, "r1", keys)))
        at_r1 = Ear(r1)
        stack.enter_context(opened(router_config(fleet, where, keys)))
        behind = {by: stack.enter_context(opened(client(where, keys, by))) for by in CERTIFICATES}
        ears = {by: Ear(session) for by, session in behind.items()}
        key = "aucamp/test/robot/r1/state"
        publisher = r1.declare_publisher(key)
        until(lambda: publisher.matching_status.matching)
        until(lambda: publisher.put("said") or all((key, "said") in ears[by].heard for by in ("recorder", *CONSOLES)))
        assert not any((key, "said") in ears[by].heard for by in (*CHAIN, STRANGER))
        kept = [say_everything(session, by) for by, session in behind.items()]
        time.sleep(SETTLED_S)
        assert at_r1.heard == set()
        del kept


# --- verbs ---
# The verbs that look at a fleet, as they are typed, in a secured one: each finds a certificate of its own name.


@pytest.fixture
def path(secured: Secured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The fleet's file; its keys lie elsewhere, and the variable says where."""
    monkeypatch.setenv(VARIABLE, str(secured.keys))
    return written(secured.fleet, tmp_path)


def written(fleet: Fleet, folder: Path) -> Path:
    fleet = replace(fleet, tank=Tank(), access=replace(fleet.access, keys="nowhere"))
    path = folder / "fleet.toml"
    path.write_text(dump(fleet))
    return path


@contextmanager
def robots(secured: Secured, state: Callable[..., State]) -> Iterator[None]:
    """All three, showing what they have to show over and over."""
    stop = threading.Event()

    def show(name: str) -> None:
        head = {"robot": name, "seq": 0, "sent_ns": 1, "t_ns": 1}
        picture = Image(**head, frame=7, width_px=4, height_px=4, jpeg=b"\xff\xd8", focus=1, enhanced=False)
        with Transport(secured.fleet, name, time.time_ns, secured.keys) as robot:
            while not stop.wait(0.05):
                robot.show(state(name))
                robot.show(picture)

    threads = [threading.Thread(target=show, args=(name,)) for name in CHAIN]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        stop.set()
        for thread in threads:
            thread.join()


def aucamp(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "agent", *arguments]
    return subprocess.Popen(
        command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=os.environ.copy()
    )


def test_record_router_and_snapshot(secured: Secured, path: Path, state: Callable[..., State], tmp_path: Path) -> None:
    where, out, picture = f"tls/127.0.0.1:{unused_port()}", tmp_path / "fleet.mcap", tmp_path / "r1.jpg"
    with robots(secured, state):
        running = [
            aucamp("record", str(path), "--out", str(out)),
            aucamp("router", str(path), "--listen", where),
            aucamp("snapshot", str(path), "--robot", "r1", "--out", str(picture)),
        ]
        try:
            until(picture.exists)
            active = out.with_name(f"{out.name}.active")
            until(lambda: active.exists() and active.stat().st_size > 10_000)
            for process in running[:2]:
                process.send_signal(signal.SIGTERM)
            said = [process.communicate(timeout=60)[0] for process in running]
        finally:
            for process in running:
                process.kill()
    assert [process.returncode for process in running] == [0, 0, 0], said
    assert f"consoles attach to {where}" in said[1] and "not heard" not in said[1]
    shown = {channel for channel in info(out).channels if channel.endswith("/state")}
    assert {f"/zenoh/aucamp/test/robot/{name}/state" for name in CHAIN} <= shown


def test_a_verb_without_its_certificate_says_what_to_do(secured: Secured, path: Path, tmp_path: Path) -> None:
    (secured.keys / "recorder.key").unlink()
    process = aucamp("record", str(path), "--out", str(tmp_path / "fleet.mcap"))
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2
    assert f"{secured.keys}/recorder.key: no such file; copy it from where aucamp keys made it" in said


def test_an_agent_says_once_that_its_fleet_is_open(
    secured: Secured, path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    known = Calibration(robot="r1", made="2026-01-01", source="a test", focus=PLAIN, camera=CAMERA)
    (tmp_path / "r1.toml").write_text(dump(known))
    assert load_setup(path, "r1").certificates == secured.keys
    assert capsys.readouterr().err == ""
    opened = {
        name: replace(robot, listen=robot.listen.replace("tls/", "tcp/")) for name, robot in secured.fleet.robot.items()
    }
    path = written(replace(secured.fleet, robot=opened), tmp_path)
    assert load_setup(path, "r1").certificates is None
    assert capsys.readouterr().err == f"r1: {OPEN}\n"
