"""How soon robots answer: a stop for all of three, over links with and without keys, and one robot that hangs.

`python -m tests.bench.network.bench_orders FLEET` is a program that floods the first robot with orders of five names.
"""

from __future__ import annotations

import itertools
import signal
import statistics
import sys
import tempfile
import time
from pathlib import Path

import msgspec

from agent.core import topics
from agent.core.codec import decode, encode
from agent.core.messages import Order, State
from agent.experiments.claim import Figure, Row
from agent.ground.console import OrderConsole
from agent.process.certificates import credentials
from agent.process.launch import free_ports
from agent.robot.fleet_reader import load_fleet
from router_config.session import Sample, Session
from router_config.settings import observer_config
from tests.bench.network.processes import agents, in_one_line, made, python
from tests.bench.timing import claim_of_medians
from tests.waiting import until

WELL_S = 120.0
NOT_IN_STEP_S = 0.037  # between stops: the robots' loops have 50 ms
FLOOD_HZ, FLOODING = 690.0, 5  # FLOODING: consoles


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    stops: int = 60  # for all three robots each


@in_one_line()
def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises Failed where a robot does not do as it is told."""
    with tempfile.TemporaryDirectory() as folder:
        one = made(Path(folder), "tls" if case == "tls" else "tcp", free_ports(3))
        keys = credentials(one.fleet, "ann", one.path)
        with agents(one) as processes, OrderConsole(one.fleet, "ann", keys) as console:
            until(lambda: len(console.states()) == 3, WELL_S, lambda: f"hears {list(console.states())} alone")
            if case == "flood":
                processes["flood"] = python("-m", "tests.bench.network.bench_orders", str(one.path))
                until(lambda: any("c0" in held for held in console.states()["r1"].ordered or ()), WELL_S)
            answers_ms = [ms for _ in range(settings.stops) for ms in stopped_ms(console)]
            processes["r2"].send_signal(signal.SIGSTOP)
            outcomes = console.order(["r1", "r2", "r3"], "stop")
            processes["r2"].send_signal(signal.SIGCONT)
    hung = outcomes.pop("r2")
    assert hung.answer is None and all(outcome.ok for outcome in outcomes.values()), outcomes
    answers = {"answer_ms": statistics.median(answers_ms), "slowest_ms": max(answers_ms)}
    others_ms = max(1e3 * outcome.took_s for outcome in outcomes.values())
    return [{**answers, "named_s": hung.took_s, "others_ms": others_ms}]


def stopped_ms(console: OrderConsole) -> list[float]:
    outcomes = console.order(["r1", "r2", "r3"], "stop")
    assert all(outcome.ok for outcome in outcomes.values()), outcomes
    time.sleep(NOT_IN_STEP_S)
    return [1e3 * outcome.took_s for outcome in outcomes.values()]


def flood(path: Path) -> None:
    """Orders that are carried out, until the process is ended."""
    fleet = load_fleet(path)
    robot, newest = next(iter(fleet.robot)), list[State]()

    def heard(sample: Sample) -> None:
        newest[:] = [decode(sample.payload(), State)]

    with Session(observer_config(fleet), "a flood") as session:
        session.subscribe(topics.key(topics.STATE, fleet=fleet.fleet, robot=robot), heard)
        until(lambda: newest, WELL_S)
        for number in itertools.count():
            seen = newest[0].incarnation, newest[0].sent_ns
            order = Order(id=number, verb="look", args={"pan_deg": float(number % 20)}, seen=seen)
            key = topics.ORDER.format(fleet=fleet.fleet, robot=robot, console=f"c{number % FLOODING}")
            session.ask(Order, key, encode(order), 1.0, lambda _: None, lambda: None)
            time.sleep(1.0 / FLOOD_HZ)


KINDS = {  # within how many ms all answer
    "tcp": (150, ""),
    "tls": (150, ", with certificates and access rules"),
    "flood": (300, f", while {FLOODING} consoles give r1 {FLOOD_HZ:g} orders a second"),
}
CLAIM = claim_of_medians(
    run=run,
    settings=Settings,
    quick={"stops": 5},
    cases=tuple(KINDS),
    measured_on="processes",
    figures=tuple(
        figure
        for kind, (most_ms, secured) in KINDS.items()
        for figure in (
            Figure(
                f"{kind}.slowest_ms<={most_ms}",
                f"runs whose slowest answer takes <= {most_ms} ms{secured}",
                "%",
                least=95.0,
            ),
            Figure(f"{kind}.named_s<=1.1", f"runs that name who hangs within 1.1 s{secured}", "%", least=95.0),
            Figure(f"{kind}.answer_ms", f"order to answer, median{secured}", "ms"),
            Figure(f"{kind}.slowest_ms", f"the slowest answer of a run, median{secured}", "ms"),
            Figure(f"{kind}.named_s", f"one of three hangs: it is named after, median{secured}", "s"),
            Figure(f"{kind}.others_ms", f"the slower of the other two, then, median{secured}", "ms"),
        )
    ),
    seeds=60,  # as many as the 95 % take
    explanation="""A console stops all of three robots sixty times in each run; then one robot's process is halted, and
        the console has to name it. The robots are real agents with real sessions, loops and recordings, whose cameras
        and motors are a script. A step of a robot comes every 50 ms, and a stop waits for it. In the flood no stop may
        go unanswered, or the run counts for nothing.""",
)

if __name__ == "__main__":
    flood(Path(sys.argv[1]))
