"""Whole swarms of real processes: twenty agents on one machine, with certificates and without, and five whose links
were cut for twenty seconds; and how news spreads in swarms of hundreds, in virtual time.

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
from agent.experiments.claim import Figure, NoSettings, Row
from agent.process.certificates import credentials
from agent.process.launch import free_ports
from agent.process.transport import Observer
from tests.bench.network.processes import agents, in_one_line, made, resident_mb, swarm_of
from tests.bench.spread import row_of
from tests.bench.timing import claim_of_medians
from tests.network.relay import Links
from tests.waiting import until

AGENTS = 20
REACH = 3  # robots on either side along a ring that a robot talks to: six neighbours, 120 directed links
NEAR_M = 0.004
AGREED_WITHIN_S = 300.0
SETTLED_S = 10.0  # over which messages are counted
PARTITION_S = 20.0
SPREAD = {"line": "a line of 300", "ring": "a ring of 100", "thousand": "1000, each with its 6 nearest"}


@in_one_line()
def run(seed: int, case: str, settings: NoSettings) -> list[Row]:
    """Raises ConfigError for healing where namespaces are not permitted, Failed where robots never agree."""
    if case in SPREAD:
        return [row_of(case, seed)]
    return [{"healed_s": healed_s()} if case == "healing" else twenty("tls" if case == "secured" else "tcp")]


def twenty(kind: str) -> Row:
    """Memory, traffic and time to agreement of AGENTS processes, from the first one's start. A link that stays mute one
    way keeps them from it, for a minute."""
    with tempfile.TemporaryDirectory() as folder:
        one, began_s = made(Path(folder), kind, free_ports(AGENTS), reach=REACH), time.monotonic()
        states: dict[str, State] = {}
        view = Observer(one.fleet, time.monotonic_ns, (STATE,), "view", credentials(one.fleet, "view", one.path))
        with agents(one) as processes, view as observer:

            def look() -> dict[str, State]:
                newest = (decode(seen.payload, State) for seen in observer.drain())
                states.update((state.robot, state) for state in newest)
                return states

            until(lambda: agreed(look()), AGREED_WITHIN_S, lambda: f"{len(states)} of {AGENTS} are heard")
            agreed_s = time.monotonic() - began_s
            before, counted_s = counts(look()), time.monotonic()
            until(lambda: look() and time.monotonic() > counted_s + SETTLED_S)
            heard, lost = (now - then for now, then in zip(counts(states), before, strict=True))
            memory_mb = statistics.median(resident_mb(process.pid) for process in processes.values())
    return {"memory_mb": memory_mb, "heard": heard / (heard + lost), "agreed_s": agreed_s}


def agreed(states: dict[str, State]) -> bool:
    """All have a posterior, count on all their neighbours, and no two differ by more than NEAR_M on any axis."""
    if len(states) < AGENTS or any(sum(n.used for n in s.neighbours) < 2 * REACH for s in states.values()):
        return False
    places = [s.posterior_m for s in states.values() if s.posterior_m is not None]
    return len(places) == AGENTS and all(max(axis) - min(axis) < NEAR_M for axis in zip(*places, strict=True))


def counts(states: dict[str, State]) -> tuple[int, int]:
    """Messages between all that arrived, and that did not."""
    near = [n for state in states.values() for n in state.neighbours]
    return sum(n.heard for n in near), sum(n.gaps for n in near)


def healed_s() -> float:
    """From the end of a partition until all five agree again."""
    with swarm_of(5) as swarm:
        swarm.watch()
        swarm.until("agreement", swarm.agree)
        swarm.relay.links = Links(sides=(frozenset({"r1", "r2"}), frozenset({"r3", "r4", "r5"})))
        time.sleep(PARTITION_S)
        swarm.relay.links = Links()
        return swarm.until("one swarm", swarm.agree)


CLAIM = claim_of_medians(
    run=run,
    cases=("twenty", "secured", "healing", *SPREAD),
    measured_on="processes",
    figures=(
        Figure("healing.healed_s", "five robots agree again after 20 s of partition", "s", most=2.0),
        Figure("twenty.agreed_s", "twenty start until all agree, six neighbours each", "s"),
        Figure("secured.agreed_s", "the same with certificates and access rules", "s"),
        Figure("secured.heard", "of the messages that they send, heard"),
        Figure("twenty.heard", "of the messages that twenty send, heard"),
        Figure("twenty.memory_mb", "memory of each of the twenty", "MB"),
        Figure("line.all_s", f"in virtual time: until all of {SPREAD['line']} know a sample of all", "s", most=10.0),
        Figure("ring.all_s", f"the same of {SPREAD['ring']}", "s", most=3.0),
        Figure("thousand.all_s", f"the same of {SPREAD['thousand']}", "s", most=4.0),
        Figure("line.bound", f"error of {SPREAD['line']} after 10 s, times that of a robot that knows all by then"),
        Figure("ring.bound", f"the same of {SPREAD['ring']}"),
        *(
            figure
            for case, who in SPREAD.items()
            for figure in (
                Figure(f"{case}.most_kb", f"{who}: its largest message", "kB", most=8.0),
                Figure(f"{case}.kb_s", f"{who}: what a link carries one way", "kB/s"),
                Figure(f"{case}.messages_hz", f"{who}: messages on a link one way", "Hz", most=20.0),
            )
        ),
    ),
    seeds=7,
    explanation="""Real agents with real sessions, loops and recordings. The twenty run on this machine, each with six
        neighbours along a ring; the five are on hosts of their own, network namespaces, with a relay between them that
        cuts two off from three. Medians of runs. In virtual time are the tables of robots that
        measure once a second and step 20 times a second, each at its own moments, with messages that take no time: what
        a line takes is bound by these steps, 25 ms a robot on average.""",
)
