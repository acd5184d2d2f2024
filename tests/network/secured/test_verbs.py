"""The verbs that look at a fleet, as they are typed, in a secured one: each finds a certificate of its own name."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import Fleet, Tank, dump
from agent.core.messages import Image, State
from agent.core.ranging.camera_model import Calibration
from agent.process.agent_process import OPEN, load_setup
from agent.process.keys import VARIABLE
from agent.process.transport import Transport
from replay.files.log import info
from tests.known_lens import CAMERA, PLAIN
from tests.network.conftest import unused_port
from tests.network.secured.conftest import Secured
from tests.network.secured.parties import CHAIN
from tests.places import ROOT
from tests.waiting import until

pytestmark = pytest.mark.slow


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
