"""How soon robots answer: a stop for all of three, over links with and without keys, and one robot that hangs."""

from __future__ import annotations

import signal
import statistics
import tempfile
import time
from pathlib import Path

import msgspec

from agent.experiments.claim import Claim, Figure, Row, Rows, Value
from agent.ground.console import OrderConsole
from agent.process.certificates import credentials
from agent.process.launch import free_ports
from tests.bench.network.processes import agents, in_one_line, made, within
from tests.bench.timing import median_figures
from tests.waiting import until

WELL_S = 120.0
NOT_IN_STEP_S = 0.037  # between stops: the robots' loops have 50 ms
MOST_MS, MOST_NAMED_S = 150.0, 1.1


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    stops: int = 60  # for all three robots each


@in_one_line()
def run(seed: int, case: str, settings: Settings) -> list[Row]:
    """Raises Failed where a robot does not do as it is told."""
    with tempfile.TemporaryDirectory() as folder:
        one = made(Path(folder), case, free_ports(3))
        keys = credentials(one.fleet, "ann", one.path)
        with agents(one) as processes, OrderConsole(one.fleet, "ann", keys) as console:
            until(lambda: len(console.states()) == 3, WELL_S, lambda: f"hears {list(console.states())} alone")
            answers_ms = [ms for _ in range(settings.stops) for ms in stopped_ms(console)]
            processes["r2"].send_signal(signal.SIGSTOP)
            outcomes = console.order(["r1", "r2", "r3"], "stop")
            processes["r2"].send_signal(signal.SIGCONT)
    hung = outcomes.pop("r2")
    assert hung.answer is None and all(outcome.ok for outcome in outcomes.values()), outcomes
    return [
        {
            "answer_ms": statistics.median(answers_ms),
            "slowest_ms": max(answers_ms),
            "named_s": hung.took_s,
            "others_ms": max(1e3 * outcome.took_s for outcome in outcomes.values()),
        }
    ]


def stopped_ms(console: OrderConsole) -> list[float]:
    outcomes = console.order(["r1", "r2", "r3"], "stop")
    assert all(outcome.ok for outcome in outcomes.values()), outcomes
    time.sleep(NOT_IN_STEP_S)
    return [1e3 * outcome.took_s for outcome in outcomes.values()]


def summary(rows: Rows) -> dict[str, Value]:
    found = median_figures(MEDIANS, rows)
    for case, runs in rows.items():
        found[f"{case}_in_time"] = within(runs, "slowest_ms", MOST_MS)
        found[f"{case}_named"] = within(runs, "named_s", MOST_NAMED_S)
    return found


KINDS = {"tcp": "", "tls": ", with certificates and access rules"}
MEDIANS = tuple(
    Figure(f"{kind}.{key}", f"{words}, median{secured}", unit)
    for kind, secured in KINDS.items()
    for key, words, unit in (
        ("answer_ms", "order to answer", "ms"),
        ("slowest_ms", "the slowest answer of a run", "ms"),
        ("named_s", "one of three hangs: it is named after", "s"),
        ("others_ms", "the slower of the other two, then", "ms"),
    )
)
JUDGED = tuple(
    Figure(f"{kind}_{key}", f"{words}{secured}", "%", least=95.0)
    for kind, secured in KINDS.items()
    for key, words in (
        ("in_time", "runs whose slowest answer comes within 150 ms"),
        ("named", "runs that name who hangs within 1.1 s"),
    )
)
CLAIM = Claim(
    run=run,
    summary=summary,
    settings=Settings,
    quick={"stops": 5},
    cases=tuple(KINDS),
    measured_on="processes",
    figures=(*JUDGED, *MEDIANS),
    seeds=60,  # as many as the 95 % take
    alone=True,
    explanation="""A console stops all of three robots sixty times in each run; then one robot's process is halted, and
        the console has to name it. The robots are real agents with real sessions, loops and recordings, whose cameras
        and motors are a script. A step of a robot comes every 50 ms, and a stop waits for it.""",
)
