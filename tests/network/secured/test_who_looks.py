"""Those who may look at a secured fleet miss nothing: recorder, view, router, snapshot, and the program `zenoh`."""

import contextlib
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from agent.core import topics
from agent.core.config import ConfigError
from agent.core.messages import Estimate, Image, State
from agent.ground.observe import next_picture
from agent.process.certificates import CONSOLE_FILE
from agent.process.transport import Transport, run_router
from router_config.session import Session
from router_config.settings import peer_config, tls
from tests.network.conftest import unused_port
from tests.network.recorder_thread import StartRecorder
from tests.network.secured.conftest import Secured
from tests.network.secured.parties import CHAIN
from tests.network.test_processes import install_entry_points
from tests.places import ROOT
from tests.waiting import until

pytestmark = pytest.mark.slow


def test_a_recorder_hears_every_row_of_every_robot(
    secured: Secured, start_recorder: StartRecorder, tmp_path: Path
) -> None:
    fleet, keys = secured
    recorder = start_recorder(fleet, tmp_path / "fleet.mcap", keys=keys)
    said = []
    with contextlib.ExitStack() as stack:
        for name in CHAIN:
            session = stack.enter_context(Session(peer_config(fleet, name, keys), name))
            session.announce(topics.ALIVE.format(fleet="test", robot=name, session=session.id))
            for row in topics.TOPICS:
                for other in fleet.robot[name].neighbours if row.writer == "src" else ("",):
                    key = topics.key(row, fleet="test", robot=name, src=name, dst=other, console="ann")
                    said.append((f"/zenoh/{key}", session.publisher(row, key)))

        def heard() -> set[str]:
            for _, publish in said:
                publish(b"anything")
            return {record.channel for record in recorder.recorded("/zenoh/")}

        wanted = {channel for channel, _ in said} | {f"/zenoh/aucamp/test/alive/{name}" for name in CHAIN}
        until(lambda: heard() >= wanted, what=lambda: wanted - heard())
    recorder.end()
    assert recorder.warnings == []


def test_robots_hear_each_other_and_nobody_else(secured: Secured, estimate: Callable[..., Estimate]) -> None:
    fleet, keys = secured
    with contextlib.ExitStack() as stack:
        robots = {name: stack.enter_context(Transport(fleet, name, time.time_ns, keys)) for name in CHAIN}
        heard: set[tuple[str, str]] = set()

        def all_pairs() -> bool:
            for name, robot in robots.items():
                for other in fleet.robot[name].neighbours:
                    robot.say(estimate(name, other))
                heard.update((item.src, name) for item in robot.drain()[0])
            return len(heard) == 4

        until(all_pairs)
        assert heard == {("r1", "r2"), ("r2", "r1"), ("r2", "r3"), ("r3", "r2")}
        assert [robot.faults() for robot in robots.values()] == [()] * 3


@contextlib.contextmanager
def showing(secured: Secured, state: Callable[..., State]) -> Iterator[Transport]:
    """r1, which shows its state and a picture over and over."""
    stop = threading.Event()
    head = {"robot": "r1", "seq": 0, "sent_ns": 1, "t_ns": 1}
    picture = Image(**head, frame=7, width_px=4, height_px=4, jpeg=b"\xff\xd8", focus=1, enhanced=False)
    with Transport(secured.fleet, "r1", time.time_ns, secured.keys) as r1:

        def show() -> None:
            while not stop.wait(0.05):
                r1.show(state("r1", seq=42))
                r1.show(picture)

        thread = threading.Thread(target=show)
        thread.start()
        try:
            yield r1
        finally:
            stop.set()
            thread.join()


def test_a_snapshot(secured: Secured, state: Callable[..., State]) -> None:
    with showing(secured, state):
        assert next_picture(secured.fleet, "r1", secured.keys).frame == 7


def zenoh(folder: Path, where: str, *options: str) -> subprocess.Popen[bytes]:
    """The program as docs/page.md has it; it prints into `folder`/printed."""
    install_entry_points(folder / "site")
    command = [str(Path(sys.executable).with_name("zenoh")), "--mode", "client", *options, "--connect", where]
    command += ["subscribe", "-k", "aucamp/**", "--decoder", "aucamp", "--line", "{key} {value}"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder / "site"), str(ROOT)])}
    with (folder / "printed").open("wb") as output:
        return subprocess.Popen(command, env=environment, stdout=output, stderr=subprocess.STDOUT)


def test_the_program_zenoh_shows_what_its_certificate_may_see(
    secured: Secured, state: Callable[..., State], tmp_path: Path
) -> None:
    """An observer's everything, at a robot and behind the router; a robot's nothing; without one there is no link."""
    fleet, keys = secured
    (tmp_path / "r2.json5").write_text(json.dumps({"transport": {"link": {"tls": tls(keys, "r2")}}}))
    r1, router = fleet.robot["r1"].listen, f"tls/127.0.0.1:{unused_port()}"
    observer = ("--config", str(keys / CONSOLE_FILE))
    tries = {
        "observer": (r1, observer),
        "behind the router": (router, observer),
        "r2": (r1, ("--config", str(tmp_path / "r2.json5"))),
        "nobody": (r1, ()),
    }
    stop = threading.Event()
    routing = threading.Thread(target=run_router, args=(fleet, stop, router), kwargs={"keys": keys})
    with showing(secured, state) as shown:
        routing.start()
        running = {}
        try:
            for who, (where, options) in tries.items():
                (tmp_path / who).mkdir()
                running[who] = zenoh(tmp_path / who, where, *options)

            def lines(who: str) -> list[str]:
                whole = (tmp_path / who / "printed").read_text().rpartition("\n")[0]
                return [line for line in whole.splitlines() if "/robot/r1/" in line]

            until(lambda: lines("observer") and lines("behind the router") and running["nobody"].poll() is not None)
            assert json.loads(lines("observer")[0].partition(" ")[2])["robot"] == "r1"
            until(lambda: len(list(shown._session._session.info.transports())) == 3)  # r2 is linked as well
            time.sleep(0.5)
            assert running["r2"].poll() is None
            assert lines("r2") == lines("nobody") == []
        finally:
            for process in running.values():
                process.kill()
                process.wait()
            stop.set()
            routing.join()


def test_a_router_says_what_does_not_fit_a_secured_fleet(secured: Secured) -> None:
    fleet, keys = secured
    with pytest.raises(ConfigError, match=r"--listen tcp/127.0.0.1:17448: the fleet is secured; write tls/HOST:PORT"):
        run_router(fleet, threading.Event(), "tcp/127.0.0.1:17448", keys=keys)
    with pytest.raises(ConfigError, match=r"certificate is good at 127.0.0.1 and localhost alone; listen there"):
        run_router(fleet, threading.Event(), "tls/192.168.7.5:17448", keys=keys)
