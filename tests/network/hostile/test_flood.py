"""A neighbour that shouts at an agent ten thousand times a second, in every way that costs something. Real processes.

The agent goes on as if it were one among many: its loop keeps time, its memory stays, and it hears the others. What it
did is read from its own black box. Two seconds of three kinds by default; AUCAMP_FLOOD_S=10 for the long version,
with all kinds, and -s for the figures. On the wall: a flood is the machine's.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest

from agent.core.codec import decode
from agent.core.config import Fleet, dump
from agent.core.messages import State
from agent.core.step_io import Inputs
from agent.core.topics import STATE
from agent.demo.demo import demo_fleet
from agent.process.transport import Observer
from replay.files.log import read
from tests.killing import killed_after
from tests.network.rogue import flooding
from tests.places import ROOT
from tests.waiting import until

SECONDS = float(os.environ.get("AUCAMP_FLOOD_S", "2"))
DEAREST = ("signed", "samples", "epochs")  # to an agent that takes them in
KINDS = ("heartbeat", "entries", "incarnations", "random", "stuffed", *DEAREST)
RATE_HZ = 10_000.0
VICTIM, HONEST, ROGUE = "r1", ("r2", "r3"), "r4"
GAP_S = 0.25  # between two steps
SILENT_S = 0.5  # between two words of a neighbour: as long as a word is valid
GROWN_MB = 64.0

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240 + 2 * len(KINDS) * SECONDS)]


class Step(NamedTuple):
    """One step of the victim's, from its black box."""

    now_ns: int
    heard: set[str]
    refused: dict[tuple[str, str], int]


class Agents:
    """The victim and its honest neighbours, scripted, each a process; and what they show."""

    def __init__(self, fleet: Fleet, folder: Path, observer: Observer) -> None:
        self.fleet, self.box = fleet, folder / f"{VICTIM}.mcap"
        self.state: dict[str, State] = {}
        self._observer = observer
        path = folder / "fleet.toml"
        path.write_text(dump(fleet))
        command = [sys.executable, "-m", "tests.network.scripted_agent", str(path)]
        self.processes = {
            name: subprocess.Popen([*command, name, str(folder), "0"], cwd=ROOT) for name in (VICTIM, *HONEST)
        }

    def listen(self) -> dict[str, State]:
        """The newest state of each."""
        for seen in self._observer.drain():
            self.state[seen.chunks["robot"]] = decode(seen.payload, State)
        dead = {name: p.returncode for name, p in self.processes.items() if p.poll() is not None}
        assert not dead
        return self.state

    def agree(self) -> bool:
        """Whether all of them see the target and count on each other."""
        states = self.listen()
        used = [{n.robot for n in state.neighbours if n.used} for state in states.values()]
        return len(used) == 3 and all(len(names & {VICTIM, *HONEST}) == 2 for names in used)

    def peak_mb(self) -> float:
        """The victim's largest resident memory so far."""
        status = Path(f"/proc/{self.processes[VICTIM].pid}/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")) / 1024.0

    def end(self) -> list[Step]:
        """Stop the victim as planned, and read what it did."""
        self.processes[VICTIM].send_signal(signal.SIGTERM)
        assert self.processes[VICTIM].wait(timeout=60) == 0
        steps = []
        for record in read(self.box):
            if record.channel == "/raw/step_in":
                inputs = decode(record.data, Inputs, limit=1 << 24)
                refused = {(row.reason, row.src or ""): row.count for row in inputs.refused}
                steps.append(Step(record.log_time_ns, {item.src for item in inputs.heard}, refused))
        return steps


@pytest.fixture
def agents(tmp_path: Path) -> Iterator[Agents]:
    fleet = demo_fleet(4, "evidence", 0.0, 0, False, tmp_path)
    with Observer(fleet, time.time_ns, (STATE,)) as observer:
        it = Agents(fleet, tmp_path, observer)
        with killed_after(it.processes):
            yield it


class Poured(NamedTuple):
    """A flood of one kind, which is over."""

    kind: str
    rate_hz: float
    began_ns: int
    ended_ns: int
    grown_mb: float


def test_floods_stop_nothing(agents: Agents, tmp_path: Path) -> None:
    """One after the other, of the kinds that cost most last: what one leaves behind the next one finds."""
    floods = [pour(agents, kind, tmp_path) for kind in (KINDS if "AUCAMP_FLOOD_S" in os.environ else DEAREST)]
    steps = agents.end()
    for flood in floods:
        bore(flood, [step for step in steps if flood.began_ns <= step.now_ns <= flood.ended_ns])


def pour(agents: Agents, kind: str, folder: Path) -> Poured:
    """Flood the victim for SECONDS, when all is well."""
    until(agents.agree, what=agents.listen)
    before_mb = agents.peak_mb()
    with flooding(agents.fleet, ROGUE, [VICTIM], kind, RATE_HZ, folder) as flood:
        began_ns, stop_s = time.time_ns(), time.monotonic() + SECONDS
        until(lambda: agents.listen() and time.monotonic() > stop_s, timeout_s=SECONDS + 60.0)
        ended_ns = time.time_ns()
    return Poured(kind, flood.sent / flood.seconds, began_ns, ended_ns, agents.peak_mb() - before_mb)


def bore(flood: Poured, steps: list[Step]) -> None:
    """The victim's loop kept time beside it, its memory stayed, it heard the others, and counted what it dropped."""
    gap_s = max((b.now_ns - a.now_ns) * 1e-9 for a, b in pairwise(steps))
    heard_ns = {name: [step.now_ns for step in steps if name in step.heard] for name in HONEST}
    silent_s = {name: longest_s(at_ns, flood.began_ns, flood.ended_ns) for name, at_ns in heard_ns.items()}
    counted = sum(step.refused.get(("flood", ROGUE), 0) for step in steps)
    sys.stdout.write(
        f"\n{flood.kind}: {flood.rate_hz:.0f}/s sent, {counted / SECONDS:.0f}/s counted; {len(steps)} steps, "
        f"longest gap {gap_s:.3f} s; silent {silent_s}; {flood.grown_mb:+.1f} MB\n"
    )
    assert flood.rate_hz > RATE_HZ / 20  # or the test does not flood
    assert counted > 100 * SECONDS
    assert gap_s < GAP_S
    assert max(silent_s.values()) < SILENT_S
    assert flood.grown_mb < GROWN_MB


def longest_s(times_ns: list[int], began_ns: int, ended_ns: int) -> float:
    """The longest time without one of these."""
    return max((b - a) * 1e-9 for a, b in pairwise([began_ns, *times_ns, ended_ns]))
