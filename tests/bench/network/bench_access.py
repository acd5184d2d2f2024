"""What certificates and access rules cost: the same fleet on tls/ with its rules, and on tcp/ without any, in turns.

Round trips and puts between two sessions of one process; the start of ten robots that all hear all, each a process of
its own; how soon a recorder hears every row, and a robot whose certificate has ended is linked once it has a new one.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, timedelta
from functools import partial
from pathlib import Path

import zenoh
from msgspec.structs import replace

from agent.core import topics
from agent.core.config import Access, Fleet, dump
from agent.demo.demo import demo_fleet, listening
from agent.ground.new_fleet import make_all
from agent.process.certificates import authority, certificate_file, issue, key_file, write
from agent.process.launch import free_ports
from replay.recorder import Arrivals, receiving
from router_config.session import Session
from router_config.settings import peer_config
from tests.places import ROOT
from tests.waiting import until

ROUNDS = 7  # of each kind, one after the other
PINGS, PUTS = 300, 1500
SIZE, LARGE = 600, 25_000  # bytes: an estimate, a picture
TEN = tuple(f"r{k}" for k in range(1, 11))
STARTS = 5

Pair = tuple[zenoh.Session, zenoh.Session]


def run() -> dict[str, dict]:
    ports = iter(free_ports(2 * (2 + len(TEN))))
    with tempfile.TemporaryDirectory() as folder:
        fleets = {kind: two(Path(folder) / kind, kind, ports) for kind in ("tcp", "tls")}
        rows = figures("access_open", "ms", 1e3, in_turns(fleets, opening))
        with ExitStack() as stack:
            pairs = {kind: stack.enter_context(linked(*fleets[kind])) for kind in fleets}
            rows |= figures("access_round_trip", "us", 1e6, in_turns(pairs, round_trip_s))
            for name, size in (("estimate", SIZE), ("picture", LARGE)):
                rows |= figures(f"access_put_{name}", "us each", 1e6, in_turns(pairs, partial(put_s, size=size)))
        rows |= seconds("access_every_row", [every_row_s(*fleets["tls"]) for _ in range(ROUNDS)])
        rows |= seconds("access_renewed", [renewed_s(*fleets["tls"]) for _ in range(3)])
        tens = {kind: ten(Path(folder) / f"ten_{kind}", kind, ports) for kind in fleets}
        mute: list[str] = []
        for name, ready in (("links", True), ("start", False)):
            start = partial(start_s, ready=ready, mute=mute)
            rows |= figures(f"access_{name}_of_ten", "s", 1.0, in_turns(tens, start, STARTS))
        for line in mute:
            print(f"never heard: {line}")
        starts = f"of {4 * (STARTS + 1)} starts with 45 links each, tcp and tls"
        return rows | {"access_mute_links": {"value": len(mute), "unit": starts, "against": None, "ratio": None}}


def in_turns(of: dict, measure: Callable, rounds: int = ROUNDS) -> dict[str, list[float]]:
    """Figures of each kind, one of each after the other; the first round warms up."""
    found: dict[str, list[float]] = {kind: [] for kind in of}
    for number in range(rounds + 1):
        for kind in list(of)[:: 1 if number % 2 else -1]:
            value = measure(of[kind])
            if number:
                found[kind].append(value)
    return found


def figures(name: str, unit: str, scale: float, found: dict[str, list[float]]) -> dict[str, dict]:
    value = statistics.median(found["tls"])
    ratio = statistics.median(tls / tcp for tls, tcp in zip(found["tls"], found["tcp"], strict=True))
    return {name: {"value": value * scale, "unit": unit, "against": "tcp without rules", "ratio": ratio}}


def seconds(name: str, found: list[float]) -> dict[str, dict]:
    return {
        name: {"value": max(found), "unit": f"s, the worst of {len(found)}", "against": "2 s", "ratio": max(found) / 2}
    }


def two(folder: Path, kind: str, ports: Iterator[int]) -> tuple[Fleet, Path]:
    return made(demo_fleet(2, None, None, None, None, folder), folder, kind, ports)


def ten(folder: Path, kind: str, ports: Iterator[int]) -> Path:
    """The file of a fleet of ten, all of them neighbours."""
    fleet = demo_fleet(2, None, None, None, None, folder)
    robots = {n: replace(fleet.robot["r1"], neighbours=tuple(o for o in TEN if o != n)) for n in TEN}
    robots = {n: replace(robot, serial=f"twin:{n}", camera=f"twin:{n}") for n, robot in robots.items()}
    made(replace(fleet, robot=robots), folder, kind, ports)
    return folder / "fleet.toml"


def made(fleet: Fleet, folder: Path, kind: str, ports: Iterator[int]) -> tuple[Fleet, Path]:
    """The fleet on ports that are free, its file and its keys in `folder`."""
    fleet = listening(fleet, [f"{kind}/127.0.0.1:{next(ports)}" for _ in fleet.robot])
    fleet = replace(fleet, access=Access(keys="keys", consoles=("ann", "bob")))
    make_all(fleet, folder / "keys")
    (folder / "fleet.toml").write_text(dump(fleet), encoding="utf-8")
    return fleet, folder / "keys"


def session(fleet: Fleet, name: str, keys: Path) -> zenoh.Session:
    return zenoh.open(zenoh.Config.from_json5(peer_config(fleet, name, keys if fleet.secured else None)))


def opening(fleet: tuple[Fleet, Path]) -> float:
    """Seconds until r1, alone, is open."""
    began_s = time.perf_counter()
    with session(fleet[0], "r1", fleet[1]):
        return time.perf_counter() - began_s


def link(fleet: Fleet, src: str, dst: str) -> str:
    return topics.key(topics.LINK, fleet=fleet.fleet, src=src, dst=dst)


@contextmanager
def linked(fleet: Fleet, keys: Path) -> Iterator[Callable[[int, int, bool], float]]:
    """r1 and r2, which sends back what it is asked to; gives what measures so many puts of a size."""
    back, count = threading.Event(), [0]  # of what is still to come
    with session(fleet, "r1", keys) as r1, session(fleet, "r2", keys) as r2:
        block = zenoh.CongestionControl.BLOCK  # every one arrives, so that they can be counted
        to_r1 = r2.declare_publisher(link(fleet, "r2", "r1"), congestion_control=block)
        to_r2 = r1.declare_publisher(link(fleet, "r1", "r2"), congestion_control=block)

        def echo(sample: zenoh.Sample) -> None:
            count[0] -= 1
            if sample.payload.to_bytes()[:1] == b"p":
                to_r1.put(sample.payload)
            elif not count[0]:
                back.set()

        def returned(_: zenoh.Sample) -> None:
            back.set()

        direct = partial(zenoh.handlers.Callback, indirect=False)
        kept = [
            r1.declare_subscriber(link(fleet, "r2", "r1"), direct(returned)),
            r2.declare_subscriber(link(fleet, "r1", "r2"), direct(echo)),
        ]
        until(lambda: to_r1.matching_status.matching and to_r2.matching_status.matching)

        def measure(times: int, size: int, answered: bool) -> float:
            payload, count[0], began_s = (b"p" if answered else b"q") * size, times, time.perf_counter()
            back.clear()
            for _ in range(times):
                to_r2.put(payload)
                if answered:
                    assert back.wait(5.0)
                    back.clear()
            assert answered or back.wait(60.0)
            return (time.perf_counter() - began_s) / times

        yield measure
        del kept


def round_trip_s(measure: Callable) -> float:
    return measure(PINGS, SIZE, True)


def put_s(measure: Callable, size: int) -> float:
    return measure(PUTS, size, False)


def every_row_s(fleet: Fleet, keys: Path) -> float:
    """From a recorder's start until it has heard every row, of robots that are up and speak 20 times a second."""
    with ExitStack() as stack:
        says = []
        for name, robot in fleet.robot.items():
            door = stack.enter_context(Session(peer_config(fleet, name, keys), name))
            for row in topics.TOPICS:
                chunks = {"robot": name, "src": name, "dst": robot.neighbours[0], "console": "ann"}
                says.append(door.publisher(row, topics.key(row, fleet=fleet.fleet, **chunks)))
        arrivals, began_s = Arrivals(time.time_ns), time.perf_counter()
        stack.enter_context(receiving(fleet, arrivals, "recorder", keys))
        while not all(arrivals.counts[row.name] for row in topics.TOPICS):
            for say in says:
                say(b"anything")
            time.sleep(0.05)
            list(arrivals.drain())
        return time.perf_counter() - began_s


def renewed_s(fleet: Fleet, keys: Path) -> float:
    """From new files of r2, which dials, until it is linked: its certificate had ended, and it goes on running."""

    def give(ends: datetime) -> None:
        for file in (certificate_file(keys, "r2"), key_file(keys, "r2")):
            file.unlink()
        write(keys, "r2", issue(authority(keys), "r2", ("127.0.0.1",), ends=ends))

    now = datetime.now(UTC)
    give(now - timedelta(days=1))
    with session(fleet, "r1", keys) as r1, session(fleet, "r2", keys):
        time.sleep(4.0)  # its pauses between two tries are as long as they get
        assert not list(r1.info.transports())
        give(now + timedelta(days=1))
        began_s = time.perf_counter()
        until(lambda: list(r1.info.transports()))
        return time.perf_counter() - began_s


def start_s(path: Path, ready: bool, mute: list[str]) -> float:
    """Until each of ten processes has heard all others: from their start, or, `ready`, from when all have loaded what
    they need and open their links. Links that stay mute one way are added to `mute`, and cost a minute."""
    began_s = time.perf_counter()
    command = [sys.executable, "-m", "tests.bench.network.one_of_ten", str(path)]
    pipe = subprocess.PIPE
    peers = {n: subprocess.Popen([*command, n], stdin=pipe, stdout=pipe, text=True, cwd=ROOT) for n in TEN}

    def told() -> dict[str, str]:
        return {name: peer.stdout.readline().strip() for name, peer in peers.items() if peer.stdout is not None}

    def go() -> None:
        for peer in peers.values():
            assert peer.stdin is not None
            peer.stdin.write("go\n")
            peer.stdin.flush()

    try:
        if ready:
            told()
            began_s = time.perf_counter()
            go()
        else:
            go()
            told()
        heard = told()
        mute += [f"{path.parent.name}: {them} to {name}" for name, them in heard.items() if them != "all"]
        return time.perf_counter() - began_s
    finally:
        for peer in peers.values():
            peer.communicate()
