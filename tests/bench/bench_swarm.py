"""Whole swarms of real processes: twenty agents on one machine, and five whose links were cut for twenty seconds.

Camera and motors are a script, because twenty rendered cameras need twenty cores.
"""

from __future__ import annotations

import statistics
import tempfile
import time
from pathlib import Path

from agent.core.codec import decode
from agent.core.messages import State
from agent.core.topics import STATE
from agent.experiments.claim import Claim, Figure, NoSettings, Row, Rows, Value
from agent.process.launch import free_ports
from agent.process.transport import Observer
from tests.bench.network.processes import agents, in_one_line, made, needs_hosts, resident_mb
from tests.bench.timing import median_figures
from tests.network.relay import Links, Relay
from tests.network.swarm_in_namespaces import WATCHER, Swarm
from tests.waiting import until

AGENTS = 20
REACH = 3  # robots on either side along a ring that a robot talks to: six neighbours, 120 directed links
NEAR_M = 0.004
AGREED_WITHIN_S = 300.0
SETTLED_S = 10.0  # over which messages are counted
PARTITION_S = 20.0


@in_one_line()
def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """Raises ConfigError for healing where namespaces are not permitted, Failed where robots never agree."""
    return [twenty() if case == "twenty" else {"healed_s": healed_s()}]


def twenty() -> Row:
    """Memory, traffic and time to agreement of AGENTS processes, from the first one's start."""
    with tempfile.TemporaryDirectory() as folder:
        one, began_s = made(Path(folder), "tcp", free_ports(AGENTS), reach=REACH), time.monotonic()
        states: dict[str, State] = {}
        with agents(one) as processes, Observer(one.fleet, time.monotonic_ns, (STATE,)) as observer:

            def look() -> dict[str, State]:
                newest = (decode(seen.payload, State) for seen in observer.drain())
                states.update((state.robot, state) for state in newest)
                return states

            until(lambda: agreed(look()), AGREED_WITHIN_S, lambda: f"{len(states)} of {AGENTS} are heard")
            agreed_s = time.monotonic() - began_s
            before, counted_s = heard(look()), time.monotonic()
            until(lambda: look() and time.monotonic() > counted_s + SETTLED_S)
            per_s = (heard(states) - before) / (time.monotonic() - counted_s)
            memory_mb = statistics.median(resident_mb(process.pid) for process in processes.values())
    asked_per_s = AGENTS * 2 * REACH * one.fleet.link.send_hz
    return {"memory_mb": memory_mb, "heard": per_s / asked_per_s, "agreed_s": agreed_s}


def agreed(states: dict[str, State]) -> bool:
    """All have a posterior, count on all their neighbours, and no two differ by more than NEAR_M on any axis."""
    if len(states) < AGENTS or any(sum(n.used for n in s.neighbours) < 2 * REACH for s in states.values()):
        return False
    places = [s.posterior_m for s in states.values() if s.posterior_m is not None]
    return len(places) == AGENTS and all(max(axis) - min(axis) < NEAR_M for axis in zip(*places, strict=True))


def heard(states: dict[str, State]) -> int:
    return sum(n.heard for state in states.values() for n in state.neighbours)


def healed_s() -> float:
    """From the end of a partition until all five agree again."""
    needs_hosts()
    names = [f"r{k}" for k in range(1, 6)]
    with Relay([*names, WATCHER], set(names)) as relay, tempfile.TemporaryDirectory() as folder:
        swarm = Swarm(relay, dict.fromkeys(names, 0.0), Path(folder))
        try:
            swarm.start(*names)
            swarm.watch()
            swarm.until("agreement", swarm.agree)
            relay.links = Links(sides=(frozenset(names[:2]), frozenset(names[2:])))
            time.sleep(PARTITION_S)
            relay.links = Links()
            return swarm.until("one swarm", swarm.agree)
        finally:
            swarm.stop()


def summary(rows: Rows) -> dict[str, Value]:
    return median_figures(CLAIM.figures, rows)


CLAIM = Claim(
    run=run,
    summary=summary,
    cases=("twenty", "healing"),
    measured_on="processes",
    figures=(
        Figure("healing.healed_s", "five robots agree again after 20 s of partition", "s", most=2.0),
        Figure("twenty.agreed_s", "twenty start until all agree, six neighbours each", "s"),
        Figure("twenty.heard", "of the messages that twenty mean to send, heard"),
        Figure("twenty.memory_mb", "memory of each of the twenty", "MB"),
    ),
    seeds=7,
    alone=True,
    explanation="""Real agents with real sessions, loops and recordings. The twenty run on this machine, each with six
        neighbours along a ring; the five are on hosts of their own, network namespaces, with a relay between them that
        cuts two off from three. Medians of runs.""",
)
