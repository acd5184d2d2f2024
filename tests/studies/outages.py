"""What a computer can do to a fleet that dives, done to real processes: `python -m tests.studies.outages [CASE ...]`.

Agents and twin are started as a user starts them, linked on loopback; behind each pty is the board's own
firmware. A case does something to them, several times, and says what came of it, a row for each thing that was done.
The exit code is 1 where a row failed. All that was started ends with the command, by Ctrl-C too.
"""

from __future__ import annotations

import argparse
import math
import os
import resource
import shlex
import signal
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from rich.table import Table

from agent.core.messages import State
from agent.core.status import fault_kind
from agent.core.topics import STATE
from agent.core.verdict import ORDER
from agent.process.command import terminal
from agent.process.launch import free_ports
from agent.process.transport import Observer
from replay.files.channels import STEP_OUT
from replay.files.log import read
from replay.files.recover import recover
from tests.bench.network.processes import made, python
from tests.killing import killed_after
from tests.network.dives.dive_of_two import ENDS_S, dive_of_two
from tests.network.dives.shown_states import ShownStates
from tests.network.scripted_agent import TARGET_M
from tests.places import ROOT
from tests.waiting import PAUSE_S

PATIENCE_S = 120.0  # of the wall, for what takes seconds of a dive


class Row(NamedTuple):
    """What was done, how often, what came of it, and what should."""

    what: str
    times: int
    figure: str
    bar: str
    ok: bool


def ills(state: State) -> list[str]:
    """Faults but for doubts about the target: r2 of these dives lives with r1's calibration."""
    return [fault for fault in state.faults if fault_kind(fault) not in ORDER]


def well(state: State) -> bool:
    """Armed, without a fault, and hears its neighbour."""
    age_s = state.neighbours[0].age_s
    return bool(state.armed) and not ills(state) and age_s is not None and age_s < 1.0


# --- clocks ---

HOUR_S = 3600
JUMPS_S = (HOUR_S, 0, -HOUR_S, 0, 5, 0, -5, 0)  # ahead of the true time, one after the other
HOLD_S = 5.0  # of the wall, at each
MUTE_S, AGREE_S = 2.0, 60.0
NEAR_M = 0.004


class JumpingClock:
    """The time of day of processes with this environment."""

    def __init__(self, folder: Path) -> None:
        library, self._file = folder / "wrong_clock.so", folder / "ahead"
        source = ROOT / "tests" / "network" / "wrong_clock.c"
        subprocess.run(["cc", "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True, timeout=60)
        self._file.write_bytes(bytes(8))
        self.environment = {"LD_PRELOAD": str(library), "CLOCK_AHEAD_FILE": str(self._file)}

    def jump(self, ahead_s: int) -> None:
        with self._file.open("r+b") as file:
            file.write(struct.pack("=q", ahead_s))


class Watch:
    """What robots showed while it held: faults, and how long nothing came of one."""

    def __init__(self, shown: ShownStates) -> None:
        self._shown, self.faults, self.gap_s = shown, set[str](), 0.0

    def hold(self, seconds: float) -> None:
        came_s = dict.fromkeys(self._shown.newest, time.monotonic())
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            before = dict(self._shown.newest)
            self._shown.listen()
            for name, state in self._shown.newest.items():
                if state is not before.get(name):
                    came_s[name] = time.monotonic()
                    self.faults.update(f"{name}: {fault}" for fault in ills(state))
                self.gap_s = max(self.gap_s, time.monotonic() - came_s[name])
            time.sleep(PAUSE_S)

    def row(self, what: str, times: int) -> Row:
        figure = f"{', '.join(sorted(self.faults)) or 'no fault'}; a state every {self.gap_s:.1f} s"
        return Row(what, times, figure, f"no fault, {MUTE_S:.0f} s", not self.faults and self.gap_s < MUTE_S)


def clocks(folder: Path) -> Iterator[Row]:
    """r1's: of a dive in the twin, and of three agents that live by the time of day. Of these r1 is then killed and
    started again, at times by a clock that is behind that of its last start."""
    clock = JumpingClock(folder)
    (dives := folder / "dive").mkdir()
    with dive_of_two(dives, speed="1", environment={"r1": clock.environment}) as (dive, shown):
        watch = Watch(shown)
        for ahead_s in JUMPS_S:
            clock.jump(ahead_s)
            watch.hold(HOLD_S)
        shown.until("well in the end", well, PATIENCE_S)
        dive.end()
    clock.jump(0)
    yield watch.row("an agent in the twin", len(JUMPS_S))
    one = made(folder / "day", "tcp", free_ports(3))
    processes: dict[str, subprocess.Popen[bytes]] = {}

    def start(name: str, times: int) -> None:
        (out := one.path.parent / f"{name}.{times}").mkdir()
        environment = {**os.environ, **(clock.environment if name == "r1" else {})}
        words = ("-m", "tests.network.scripted_agent", str(one.path), name, str(out))
        processes[name] = python(*words, env=environment, stderr=subprocess.DEVNULL)

    with killed_after(processes), Observer(one.fleet, time.monotonic_ns, (STATE,)) as observer:
        shown = ShownStates(observer, tuple(one.fleet.robot))

        def agree(state: State) -> bool:
            near = state.posterior_m is not None and math.dist(state.posterior_m, TARGET_M) < NEAR_M
            return near and not ills(state) and sum(n.used for n in state.neighbours) == len(one.fleet.robot) - 1

        for name in one.fleet.robot:
            start(name, 0)
        shown.until("agreement", agree, PATIENCE_S)
        watch, took_s = Watch(shown), list[float]()
        for times, ahead_s in enumerate(JUMPS_S, start=1):
            clock.jump(ahead_s)
            watch.hold(HOLD_S)
            processes["r1"].kill()
            processes["r1"].wait()
            began_s, old = time.monotonic(), shown.newest["r1"].incarnation
            start("r1", times)
            shown.until("its new start", lambda s, old=old: s.incarnation != old, PATIENCE_S, "r1")
            shown.until(f"agreement after a start {ahead_s} s ahead", agree, PATIENCE_S)
            took_s.append(time.monotonic() - began_s)
            off_s = shown.newest["r1"].sent_ns * 1e-9 - time.time()
            assert abs(off_s - ahead_s) < MUTE_S, f"its clock is {off_s:.0f} s ahead, not {ahead_s} s"
    yield watch.row("an agent by the time of day", len(JUMPS_S))
    figure = f"all three agree after {max(took_s):.1f} s at most"
    yield Row("then it is started again", len(took_s), figure, f"{AGREE_S:.0f} s", max(took_s) < AGREE_S)


# --- memory ---

DIVE_S = 60.0
LIMITS_MB = (128, 192, 256, 320, 384, 448, 512)  # of data, all below agent.process.launch.AGENT_TAKES_MB
CUTS_MB = (2, 10, 20)  # below what a running agent has, of data
WITHOUT_S = 20.0  # of the dive, and before it as long


def memory(folder: Path) -> Iterator[Row]:
    """How much an agent takes; then what becomes of one that may not have it, at its start and later."""
    with dive_of_two(folder) as (dive, shown):
        goal_ns = dive.clock.now_ns() + round(1e9 * DIVE_S)
        shown.until("a dive", lambda s: s.sent_ns > goal_ns, 10 * DIVE_S)
        has = {name: status_mb(dive.processes[name].pid) for name in ("r1", "r2")}
        rss, data, space = (max(one[key] for one in has.values()) for key in ("VmHWM", "VmData", "VmPeak"))
        figure = f"{rss:.0f} MB resident at most; {data:.0f} MB of data, {space:.0f} MB of addresses"
        yield Row(f"a dive of {DIVE_S:.0f} s", len(has), figure, "none", True)
        path = str(dive.path)
        dive.end()
    said = [started_with(limit_mb, path, "--robot", "r1", "--out", str(folder)) for limit_mb in LIMITS_MB]
    what = f"started with {LIMITS_MB[0]} to {LIMITS_MB[-1]} MB of data"
    yield Row(what, len(said), f"{sum(said)} end with one line", "all", all(said))
    went = [cut(folder / f"cut{cut_mb}", cut_mb) for cut_mb in CUTS_MB]
    figure = "; ".join(f"{cut_mb} MB below: {text}" for cut_mb, (text, _) in zip(CUTS_MB, went, strict=True))
    yield Row("gets no more in a dive", len(went), figure, "no hang, file whole", all(ok for _, ok in went))


def started_with(limit_mb: int, *words: str) -> bool:
    """Whether an agent that may have so much ends with one line."""
    command = f"ulimit -d {limit_mb * 1000}; exec {shlex.join([sys.executable, '-m', 'agent', 'agent', *words])}"
    try:
        done = subprocess.run(command, shell=True, capture_output=True, text=True, timeout=ENDS_S, cwd=ROOT)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 2 and done.stderr.startswith("aucamp: ") and done.stderr.count("\n") == 1


def status_mb(pid: int) -> dict[str, float]:
    """What Linux' /proc says of a process' memory."""
    lines = (line.split() for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.endswith(" kB"))
    return {words[0].rstrip(":"): float(words[1]) / 1000.0 for words in lines}


def cut(folder: Path, cut_mb: float) -> tuple[str, bool]:
    """From now on r1 may have less than it has. What it does then, and whether that is good."""
    folder.mkdir()
    with dive_of_two(folder) as (dive, shown):
        goal_ns = dive.clock.now_ns() + round(1e9 * WITHOUT_S)
        shown.until("a dive with it", lambda s: s.sent_ns > goal_ns, PATIENCE_S)
        r1 = dive.processes.pop("r1")  # nobody misses it if it ends
        data = round(1e6 * (status_mb(r1.pid)["VmData"] - cut_mb))
        resource.prlimit(r1.pid, resource.RLIMIT_DATA, (data, data))
        with killed_after({"r1": r1}):
            cut_ns = dive.clock.now_ns() + round(1e9 * WITHOUT_S)
            shown.until("a dive without it", lambda s: s.sent_ns > cut_ns, PATIENCE_S, "r2")
            ended = r1.poll() is not None
            r1.send_signal(signal.SIGTERM)
            try:
                code = r1.wait(ENDS_S)
            except subprocess.TimeoutExpired:
                return "hangs", False
        said = [line for line in dive.log("r1").splitlines() if line.startswith("aucamp: ")]
    (file,) = folder.glob("r1.mcap*")
    steps = sum(record.channel == STEP_OUT.name for record in read(recover(file).out or file))
    text = (said[-1] if said else f"ends with {code}") if ended else "goes on"
    return f"{text}, {steps} steps recorded", steps > 0 and (bool(said) or not ended)


# --- all of them ---

LONGEST = 2000  # characters of what is said of a failure
Case = Callable[[Path], Iterator[Row]]
CASES: dict[str, tuple[str, Case]] = {
    "clocks": ("the time of day jumps on one computer", clocks),
    "memory": ("an agent may not have the memory that it takes", memory),
}


def rows_of(name: str, case: Case) -> Iterator[Row]:
    """A case's rows; where it waits in vain, the last one says for what."""
    with tempfile.TemporaryDirectory(prefix=f"outage-{name}-") as folder:
        try:
            yield from case(Path(folder))
        except AssertionError as error:
            yield Row(name, 1, " ".join(str(error).split())[:LONGEST] or "went wrong", "none", False)


def main(arguments: Sequence[str]) -> int:
    asked = argparse.ArgumentParser(prog="python -m tests.studies.outages", description=__doc__)
    about = "; ".join(f"{name}: {what}" for name, (what, _) in CASES.items())
    asked.add_argument("case", nargs="*", help=f"{about}. All if none is named")
    given = asked.parse_args(arguments).case or list(CASES)
    if unknown := set(given) - set(CASES):
        asked.error(f"no such case: {', '.join(sorted(unknown))}")
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))
    os.environ.pop("RUST_BACKTRACE", None)  # a panic in Zenoh's threads is to look as it does elsewhere
    console, failed = terminal(), False
    for name in given:
        began_s = time.monotonic()
        table = Table("what", "times", "came of it", "bar", "", title=f"{name}: {CASES[name][0]}", title_justify="left")
        for row in rows_of(name, CASES[name][1]):
            table.add_row(row.what, str(row.times), row.figure, row.bar, "ok" if row.ok else "FAILED")
            failed |= not row.ok
        console.print(table, f"took {time.monotonic() - began_s:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
