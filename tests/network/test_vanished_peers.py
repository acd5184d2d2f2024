"""Half of a fleet vanishes at once, as where a switch loses power: those that are left go on hearing each other.

Six sessions in network namespaces, as agents open theirs, each linked to all others.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import zenoh
from msgspec.structs import replace

from agent.core.config import Fleet, dump
from agent.robot.fleet_reader import load_fleet
from router_config.session import Session
from router_config.settings import peer_config
from tests.network.relay import Links, Relay, refused

NAMES = tuple(f"r{number}" for number in range(1, 7))
SIDES = (frozenset(NAMES[:3]), frozenset(NAMES[3:]))
LINKED_S, APART_S = 8.0, 7.0
DEAF_S = 3.0  # a link that is not read is ended and made anew within that
NO_NAMESPACES = refused()

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(120),
    pytest.mark.skipif(NO_NAMESPACES is not None, reason=f"network namespaces are not permitted: {NO_NAMESPACES}"),
]


def talk(fleet_path: str, name: str) -> None:
    """Say something five times a second, and write who is heard, and when."""

    def heard(sample: zenoh.Sample) -> None:
        other = str(sample.key_expr).rpartition("/")[2]
        sys.stdout.write(f"{time.monotonic()} {other}\n")
        sys.stdout.flush()

    with Session(peer_config(load_fleet(Path(fleet_path)), name), name) as session:
        session._session.declare_subscriber("x/*", heard)
        said = session._session.declare_publisher(f"x/{name}", congestion_control=zenoh.CongestionControl.DROP)
        while True:
            said.put(bytes(200))
            time.sleep(0.2)


@pytest.fixture
def relay() -> Iterator[Relay]:
    with Relay(list(NAMES), set(NAMES)) as relay:
        yield relay


def test_who_is_left_hears_who_is_left(relay: Relay, make_fleet: Callable[..., Fleet], tmp_path: Path) -> None:
    fleet = make_fleet({name: tuple(other for other in NAMES if other != name) for name in NAMES})
    robots = {name: replace(robot, listen=f"tcp/{relay.address[name]}:7447") for name, robot in fleet.robot.items()}
    path = tmp_path / "fleet.toml"
    path.write_text(dump(replace(fleet, robot=robots)))
    program = f"from tests.network.test_vanished_peers import talk; talk({str(path)!r}, "
    logs = {name: tmp_path / f"{name}.log" for name in NAMES}
    started = []
    try:
        for name in NAMES:
            with logs[name].open("w") as log:
                command = relay.command(name, sys.executable, "-c", f"{program}{name!r})")
                started.append(subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT))
        time.sleep(LINKED_S)
        apart_s = time.monotonic()
        relay.links = Links(sides=SIDES)
        time.sleep(APART_S)
    finally:
        for one in started:
            one.kill()
            one.wait()
    for side in SIDES:
        for name in side:
            heard = [line.split() for line in logs[name].read_text().splitlines()]
            times_s = {other: [float(words[0]) for words in heard if words[1:] == [other]] for other in NAMES}
            for other in side - {name}:
                late_s = [s for s in times_s[other] if s > apart_s - 1.0]
                assert late_s, f"{name} never heard {other}: {logs[name].read_text()[-2000:]}"
                gaps_s = [b - a for a, b in zip(late_s, [*late_s[1:], apart_s + APART_S], strict=True)]
                assert max(gaps_s) < DEAF_S, f"{name} did not hear {other} for {max(gaps_s):.1f} s"
            assert max(times_s[next(iter(set(NAMES) - side))]) < apart_s + 1.0
