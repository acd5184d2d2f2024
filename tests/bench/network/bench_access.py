"""What certificates and access rules cost: the same fleet on tls/ with its rules, and on tcp/ without any, in turns."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

import zenoh

from agent.core import topics
from agent.experiments.claim import Figure, Row
from agent.process.launch import free_ports
from replay.recorder import Arrivals, receiving
from router_config.session import Session
from router_config.settings import peer_config
from tests.bench.network.processes import Made, in_one_line, made
from tests.bench.timing import Settings, claim_of_medians, medians_ms
from tests.waiting import until

KINDS = ("tcp", "tls")
PINGS, SIZE = 300, 600  # SIZE: bytes, of an estimate


@in_one_line()
def run(seed: int, case: str, settings: Settings) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        return CASES[case](Path(folder), settings.times)


def two_sessions(folder: Path, times: int) -> list[Row]:
    """Round trips between two sessions of this process, in us each, medians."""
    ports = {kind: free_ports(4)[2 * k : 2 * k + 2] for k, kind in enumerate(KINDS)}
    with ExitStack() as stack:
        fleets = {kind: made(folder / kind, kind, ports[kind]) for kind in KINDS}
        ways = {kind: stack.enter_context(linked(one)) for kind, one in fleets.items()}
        return [{way: 1e3 * ms / PINGS for way, ms in medians_ms(ways, times, time.perf_counter).items()}]


@contextmanager
def linked(one: Made) -> Iterator[Callable[[], None]]:
    """r1, and r2, which sends back whatever comes; gives what sends PINGS, each when the one before is back."""
    back = threading.Event()
    keys = one.keys if one.fleet.secured else None
    r1_config, r2_config = (zenoh.Config.from_json5(peer_config(one.fleet, name, keys)) for name in ("r1", "r2"))
    there, here = (
        topics.key(topics.LINK, fleet=one.fleet.fleet, src=src, dst=dst) for src, dst in (("r1", "r2"), ("r2", "r1"))
    )
    direct = partial(zenoh.handlers.Callback, indirect=False)
    with zenoh.open(r1_config) as r1, zenoh.open(r2_config) as r2:
        to_r1, to_r2 = r2.declare_publisher(here), r1.declare_publisher(there)
        kept = [
            r1.declare_subscriber(here, direct(lambda _: back.set())),
            r2.declare_subscriber(there, direct(lambda sample: to_r1.put(sample.payload))),
        ]
        until(lambda: to_r1.matching_status.matching and to_r2.matching_status.matching)

        def send() -> None:
            for _ in range(PINGS):
                back.clear()
                to_r2.put(b"p" * SIZE)
                assert back.wait(5.0), "a message never came back"

        yield send
        del kept


def recorder(folder: Path, times: int) -> list[Row]:
    one = made(folder, "tls", free_ports(2))
    return [{"every_row_s": every_row_s(one)} for _ in range(times)]


def every_row_s(one: Made) -> float:
    """From a recorder's start until it has heard every row, of robots that are up and speak 20 times a second."""
    with ExitStack() as stack:
        says = []
        for name, robot in one.fleet.robot.items():
            door = stack.enter_context(Session(peer_config(one.fleet, name, one.keys), name))
            for row in topics.TOPICS:
                chunks = {"robot": name, "src": name, "dst": robot.neighbours[0], "console": "ann"}
                says.append(door.publisher(row, topics.key(row, fleet=one.fleet.fleet, **chunks)))
        arrivals, began_s = Arrivals(time.time_ns), time.perf_counter()
        stack.enter_context(receiving(one.fleet, arrivals, "recorder", one.keys))
        while not all(arrivals.counts[row.name] for row in topics.TOPICS):
            for say in says:
                say(b"anything")
            time.sleep(0.05)
            list(arrivals.drain())
        return time.perf_counter() - began_s


CASES = {"two-sessions": two_sessions, "recorder": recorder}


CLAIM = claim_of_medians(
    run=run,
    settings=Settings,
    quick={"times": 2},
    cases=tuple(CASES),
    measured_on="processes",
    figures=(
        Figure("two-sessions.tls", "600 bytes there and back, secured", "us"),
        Figure("two-sessions.tls/tcp", "times as long as on tcp without rules", most=1.3),
        Figure("recorder.every_row_s", "a recorder's start until it has heard every row", "s"),
        Figure("recorder.every_row_s<=2", "such starts that take no more than 2 s", "%", least=95.0),
    ),
    seeds=7,
    explanation="""The same fleets on tls/ with certificates and access rules, and on tcp/ with neither. Round trips go
        between two sessions of one process, in turns. Ratios are medians of runs.""",
)
