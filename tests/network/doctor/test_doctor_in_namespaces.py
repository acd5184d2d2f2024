"""`aucamp doctor` on a computer of its own, looking at robots on three others: a clock that is an hour off, a link that
is cut, an address that swallows all packets, an agent that hangs.

Each a process in a network namespace, with certificates of this run.
"""

import json
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from agent.core.config import Access, dump
from agent.ground.new_fleet import make_all
from tests.network.relay import Links, Relay, refused
from tests.network.swarm_in_namespaces import Swarm
from tests.places import ROOT
from tests.waiting import until

CLOCK_AHEAD_S = {"r1": 0.0, "r2": 3600.0, "r3": 0.0}
DESK = "desk"
CLOCK = "warning r2: its clock is 3600 s ahead of this computer's"
NO_NAMESPACES = refused()

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(NO_NAMESPACES is not None, reason=f"network namespaces are not permitted: {NO_NAMESPACES}"),
]

Doctor = Callable[[], list[str]]


@pytest.fixture
def swarm(tmp_path: Path) -> Iterator[Swarm]:
    """Three robots that are neighbours of each other, secured."""
    hosts = [*CLOCK_AHEAD_S, DESK]
    with Relay(hosts, set(hosts)) as relay:
        it = Swarm(relay, CLOCK_AHEAD_S, tmp_path)
        robots = {
            name: replace(robot, listen=robot.listen.replace("tcp/", "tls/")) for name, robot in it.fleet.robot.items()
        }
        it.fleet = replace(it.fleet, robot=robots, access=Access(keys="keys", consoles=("ann",)))
        it.path.write_text(dump(it.fleet))
        make_all(it.fleet, tmp_path / "keys")
        try:
            it.start(*CLOCK_AHEAD_S)
            yield it
        finally:
            for process in it.processes.values():
                process.kill()
                process.wait()


@pytest.fixture
def doctor(swarm: Swarm) -> Doctor:
    """What it finds, and would have mended."""
    command = swarm.relay.command(
        DESK, sys.executable, "-m", "agent", "doctor", str(swarm.path), "--as", "ann", "--json"
    )

    def look() -> list[str]:
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=60)
        assert not done.stderr
        diagnosis = json.loads(done.stdout)
        bad = [f"{one['level']} {one['about']}: {one['text']}" for one in diagnosis["findings"] if one["level"] != "ok"]
        assert done.returncode == (1 if bad else 0)
        return bad

    return look


def test_what_is_wrong_between_computers(swarm: Swarm, doctor: Doctor) -> None:
    listen = {name: robot.listen for name, robot in swarm.fleet.robot.items()}

    def finds(*beginnings: str) -> bool:
        found = sorted(doctor())
        return len(found) == len(beginnings) and all(map(str.startswith, found, sorted(beginnings)))

    until(lambda: finds(CLOCK), 60.0, lambda: f"all are up, and one clock is wrong: {doctor()}")

    swarm.relay.links = Links(apart=frozenset({"r1", "r2"}))
    apart = (
        f"wrong r1: r1 and r2 do not hear each other: no link: r2 dials r1 at {listen['r1']}; look from r2's computer"
    )
    until(lambda: finds(CLOCK, apart), 60.0, lambda: f"a link is cut: {doctor()}")

    swarm.relay.links = Links(sides=(frozenset({"r3"}),))
    far = f"wrong r3: {listen['r3']}: no answer in a second; look whether its computer is on"
    until(lambda: finds(CLOCK, far), 60.0, lambda: f"a computer is out of reach: {doctor()}")

    swarm.relay.links = Links()  # and what was missed meanwhile is history
    swarm.processes["r1"].send_signal(signal.SIGSTOP)
    hangs = f"wrong r1: {listen['r1']}: takes the call, but no handshake follows: its agent hangs"
    until(lambda: finds(CLOCK, hangs), 60.0, lambda: f"an agent hangs: {doctor()}")
