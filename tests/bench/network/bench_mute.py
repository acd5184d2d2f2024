"""Links after a handshake that a stop went through, and ten agents whose links are well beside two busy processes."""

from __future__ import annotations

import subprocess
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import msgspec

from agent.core.topics import STATE
from agent.experiments.claim import Figure, Row
from agent.process.launch import free_ports
from agent.process.transport import Observer
from router_config.session import UNREAD
from tests.bench.network.processes import in_one_line, made, python
from tests.bench.timing import claim_of_medians
from tests.killing import killed_after
from tests.network.mute_link import FLEET, provoked
from tests.waiting import until

PATIENCE_S = 20.0  # a link that is not heard by then stays mute
AGENTS, BUSY = 10, 2
WELL_S = 300.0


class Settings(msgspec.Struct, frozen=True, kw_only=True):
    """What can be asked."""

    soak_s: float = 3600.0


@in_one_line()
def run(seed: int, case: str, settings: Settings) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        if case == "soak":
            return [{"alarms": alarms(Path(folder), settings.soak_s)}]
        one = made(Path(folder), "tls" if case == "tls" else "tcp", free_ports(2), name=FLEET)
        with provoked(one.fleet, one.keys if one.fleet.secured else None, short=case == "older") as pair:
            return [{"healed_s": pair.healed_s(PATIENCE_S) or PATIENCE_S}]


def alarms(folder: Path, soak_s: float) -> int:
    """Links of agents that were well and were ended."""
    one, processes = made(folder, "tcp", free_ports(AGENTS)), dict[str, subprocess.Popen[Any]]()
    with ExitStack() as stack:
        said = stack.enter_context((folder / "said.txt").open("w+"))
        stack.enter_context(killed_after(processes))
        for number in range(BUSY):
            processes[f"busy {number}"] = python("-c", "while True: pass")
        for name in one.fleet.robot:
            words = ("-m", "tests.network.scripted_agent", str(one.path), name, str(folder))
            processes[name] = python(*words, stderr=said)
        heard: set[str] = set()
        with Observer(one.fleet, time.monotonic_ns, (STATE,)) as observer:

            def all_heard() -> bool:
                heard.update(seen.chunks["robot"] for seen in observer.drain())
                return len(heard) == AGENTS

            until(all_heard, WELL_S, lambda: f"{len(heard)} of {AGENTS} are heard")
        time.sleep(soak_s)
        assert all(process.poll() is None for process in processes.values()), "an agent has ended"
        said.seek(0)
        return sum(UNREAD in line for line in said)


CASES = {  # within how many seconds both hear each other
    "tcp": (2, ""),
    "tls": (2, ", with certificates"),
    "older": (4, ", where Zenoh's own time-outs cut it off"),
}
CLAIM = claim_of_medians(
    run=run,
    settings=Settings,
    quick={"soak_s": 60.0},
    cases=(*CASES, "soak"),
    by_default=tuple(CASES),
    measured_on="processes",
    figures=(
        *(
            figure
            for case, (most_s, words) in CASES.items()
            for figure in (
                Figure(f"{case}.healed_s<={most_s}", f"both hear within {most_s} s{words}", "%", least=90.0),
                Figure(f"{case}.healed_s", f"until both hear, median{words}", "s"),
            )
        ),
        Figure("soak.alarms", "links that were well and were ended, ten agents in an hour", most=0.0),
    ),
    seeds=40,
    explanation="""Two sessions link through a proxy that holds the handshake for 1.9 s; one process is stopped in the
        middle of it until 2.2 s. Counted from there. With time-outs of Zenoh's own of two seconds, as older versions of
        Aucamp have them, the link is mute one way until the watchdog ends it. The soak, `--only soak --seeds 1`, is
        ten agents that link all with all beside two busy processes.""",
)
