"""Robots as processes of their own, and the command line of Zenoh as a user types it. On the wall: nobody dives."""

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from agent.core.codec import decode
from agent.core.config import Fleet, dump
from agent.core.messages import Estimate, State
from agent.process.transport import Transport
from tests.places import ROOT
from tests.waiting import until

PAIR = {"r1": ("r2",), "r2": ("r1",)}

TALK = """
import pathlib, signal, sys, time
from agent.robot.fleet_reader import load_fleet
from agent.core.messages import Estimate
from agent.process.transport import Transport
fleet, me, other, last = load_fleet(pathlib.Path(sys.argv[1])), sys.argv[2], sys.argv[3], int(sys.argv[4])
signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
with Transport(fleet, me, time.time_ns) as transport:
    for seq in range(last):
        transport.say(Estimate(fleet="test", src=me, dst=other, incarnation=1, seq=seq, sent_ns=time.time_ns(),
                               target="ball", t=0, valid=False))
        time.sleep(0.02)
"""


def talk(path: Path, me: str, other: str, last: int) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([sys.executable, "-c", TALK, path, me, other, str(last)], cwd=ROOT)


@pytest.fixture
def pair(make_fleet: Callable[..., Fleet], tmp_path: Path) -> tuple[Fleet, Path]:
    fleet = make_fleet(PAIR)
    path = tmp_path / "fleet.toml"
    path.write_text(dump(fleet))
    return fleet, path


def test_two_processes_hear_each_other_and_sigterm_ends_one(pair: tuple[Fleet, Path]) -> None:
    fleet, path = pair
    with Transport(fleet, "r2", time.time_ns) as r2, talk(path, "r1", "r2", last=100_000) as r1:
        try:
            seqs: list[int] = []

            def enough() -> bool:
                seqs.extend(decode(heard.payload, Estimate).seq for heard in r2.drain()[0])
                return len(seqs) > 10

            until(enough, timeout_s=60)
            assert seqs == sorted(set(seqs))  # a poll that came late may have missed some
            r1.send_signal(signal.SIGTERM)
            assert r1.wait(timeout=60) == 0
        finally:
            r1.kill()


def test_a_process_ends_by_itself_while_others_talk_to_it(pair: tuple[Fleet, Path]) -> None:
    fleet, path = pair
    with Transport(fleet, "r2", time.time_ns) as r2, talk(path, "r1", "r2", last=150) as r1:
        try:
            until(lambda: r2.drain()[0], timeout_s=60)
            assert r1.wait(timeout=60) == 0
        finally:
            r1.kill()


def test_the_command_line_of_zenoh_shows_a_readable_line(
    pair: tuple[Fleet, Path], state: Callable[..., State], tmp_path: Path
) -> None:
    fleet, _ = pair
    install_entry_points(tmp_path / "site")
    command = [Path(sys.executable).with_name("zenoh"), "--mode", "client", "--connect", fleet.robot["r1"].listen]
    command += ["subscribe", "-k", "aucamp/**", "--decoder", "aucamp", "--line", "{key} {value}"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path / "site"), str(ROOT)])}
    printed = tmp_path / "printed"
    with (
        printed.open("wb") as output,
        Transport(fleet, "r1", time.time_ns) as r1,
        subprocess.Popen(command, env=environment, stdout=output, stderr=subprocess.STDOUT) as zenoh,
    ):
        try:

            def line() -> bool:
                r1.show(state("r1", seq=42))
                assert zenoh.poll() is None, printed.read_text()
                return b"\n" in printed.read_bytes()

            until(line, timeout_s=60)
        finally:
            zenoh.kill()
    key, _, value = printed.read_text().splitlines()[0].partition(" ")
    assert key.endswith("/robot/r1/state")
    assert json.loads(value)["t"] == 42


def install_entry_points(site: Path) -> None:
    """Declare the entry points that pyproject.toml names, as an installation would."""
    about = site / "aucamp_under_test-0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: aucamp-under-test\nVersion: 0\n")
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    lines = [f"[{group}]\n" + "".join(f"{k} = {v}\n" for k, v in names.items()) for group, names in groups.items()]
    (about / "entry_points.txt").write_text("\n".join(lines))
