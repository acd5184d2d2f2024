"""Outages of devices, clocks, memory and certificates."""

from __future__ import annotations

import math
import os
import random
import resource
import shlex
import signal
import statistics
import struct
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from agent.core.codec import decode
from agent.core.config import Fleet
from agent.core.messages import State
from agent.core.status import fault_kind
from agent.core.step_io import Inputs
from agent.core.topics import STATE
from agent.core.verdict import ORDER
from agent.ground.console import OrderConsole
from agent.process.launch import free_ports
from agent.process.transport import Observer
from hw.firmware.failsafe import DISARM, SURFACE
from hw.twin.scene import SCENES
from replay.check.check import check
from replay.check.reexecute import STEP_BYTES
from replay.files.channels import STEP_IN, STEP_OUT
from replay.files.info import info
from replay.files.log import read
from replay.files.recover import recover
from tests.bench.network.processes import made, python
from tests.dive_timing import timing
from tests.killing import killed_after
from tests.network.dives.dive_of_two import ENDS_S, dive_of_two
from tests.network.dives.shown_states import ShownStates
from tests.network.scripted_agent import TARGET_M
from tests.places import ROOT
from tests.waiting import PAUSE_S, until

PATIENCE_S = 120.0  # of the wall, for what takes seconds of a dive
STEP_GAP_S = 0.25  # between two steps of a loop that hangs nowhere


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


# --- the tether ---
# The twin's own event: it closes its end of the pty, and the agent's end hangs up as a USB adapter's does.

PULLED_S = {40.0: 6.0, 60.0: 6.0, 80.0: 25.0}  # when, by the dive's clock, and for how long
SURFACES_S = 10.0  # then it is up, and has switched its motors off
NAMED_S, BACK_S = 3.0, 5.0


def serial(folder: Path) -> Iterator[Row]:
    """r1's is pulled: for so long that the board surfaces, and for so long that it has switched its motors off."""

    def pulled(fleet: Fleet) -> Fleet:
        events = "".join(
            f'[[event]]\nkind = "serial_unplug"\nrobot = "r1"\nat_s = {at_s}\nfor_s = {for_s}\n'
            for at_s, for_s in PULLED_S.items()
        )
        scene = folder / "pulled.toml"
        scene.write_text((SCENES / "tank.toml").read_text() + events)
        return replace(fleet, twin=replace(fleet.twin, scene=str(scene)))

    named, back, ends_ns = [], [], []
    with dive_of_two(folder, change=pulled) as (dive, shown), OrderConsole(dive.fleet, "ann") as ann:
        start_ns = dive.clock.start_ns or 0
        assert dive.clock.now_ns() - start_ns < 1e9 * min(PULLED_S), "the dive began too late"
        for at_s, for_s in PULLED_S.items():
            out_ns = start_ns + round(1e9 * at_s)
            in_ns = out_ns + round(1e9 * for_s)
            shown.until(
                "no telemetry", lambda s, ns=out_ns: s.sent_ns > ns and "no telemetry" in s.faults, PATIENCE_S, "r1"
            )
            named.append((shown.newest["r1"].sent_ns - out_ns) * 1e-9)
            shown.until("telemetry", lambda s, ns=in_ns: s.sent_ns > ns and s.armed is not None, PATIENCE_S, "r1")
            back.append((shown.newest["r1"].sent_ns - in_ns) * 1e-9)
            ends_ns.append(in_ns)
            if for_s > SURFACES_S:
                ann.order(("r1",), "arm", {}, answer_s=PATIENCE_S)
            shown.until("well again", well, PATIENCE_S)
        dive.end()
    late_s = timing(folder / "r1.mcap").step_gap_s
    bar = f"{NAMED_S:.0f} s, {BACK_S:.0f} s, no step after {STEP_GAP_S} s"
    figure = f"'no telemetry' after {max(named):.1f} s, used again after {max(back):.1f} s, a step every {late_s:.2f} s"
    ok = max(named) < NAMED_S and max(back) < BACK_S and late_s < STEP_GAP_S
    yield Row("pulled and put back", len(named), figure, bar, ok)
    told = [
        telemetry
        for record in read(folder / "r1.mcap")
        if record.channel == STEP_IN.name
        for telemetry in decode(record.data, Inputs, limit=STEP_BYTES).telemetry
    ]
    first = [next(telemetry for telemetry in told if telemetry.t_ns > in_ns) for in_ns in ends_ns]
    boards = [(telemetry.ladder, telemetry.armed) for telemetry in first]
    figure = "; ".join(
        f"after {for_s:.0f} s failsafe {ladder}, motors {'on' if armed else 'off'}"
        for for_s, (ladder, armed) in zip(PULLED_S.values(), boards, strict=True)
    )
    bar = f"{SURFACE}: surfaces, twice; {DISARM}: off"
    ok = boards == [(SURFACE, True), (SURFACE, True), (DISARM, False)]
    yield Row("what its board did", len(boards), figure, bar, ok)


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


# --- kills ---

KILLS = 20
LOST_S, LIVES_S = 1.0, (0.3, 2.5)
SEED = 48


def kills(folder: Path) -> Iterator[Row]:
    """At random moments of one dive; what was killed is started again, and all is well before the next one. The twin
    records nothing: looked at is what the agent records meanwhile."""
    moments = random.Random(SEED)
    with dive_of_two(folder, speed="1") as (dive, shown), OrderConsole(dive.fleet, "ann") as ann:

        def written(stem: str) -> Path:
            """The recording that is being written."""
            files = [file for file in folder.glob(f"{stem}*.mcap.active") if ".recovered" not in file.name]
            return max(files, key=lambda file: file.stat().st_mtime)

        def start(name: str) -> None:
            before = set(folder.glob("*.active"))
            match name:
                case "recorder":
                    dive.start_recorder()
                    until(lambda: set(folder.glob("fleet*.active")) - before and newest_ns(written("fleet")))
                case "twin":
                    dive.start_twin("1")
                    shown.until("boards", lambda s: s.armed is False, PATIENCE_S)
                    ann.order(dive.fleet.robot, "arm", {}, answer_s=PATIENCE_S)
                case _:
                    dive.start_agent(name)
            now_ns = dive.clock.now_ns()
            shown.until(f"well after {name}", lambda s: s.sent_ns > now_ns and well(s), PATIENCE_S)

        start("recorder")
        for name, stem in (("recorder", "fleet"), ("r1", "r1"), ("twin", "r1")):
            lost_s, mended = [], []
            for _ in range(KILLS):
                watched_s = time.monotonic() + moments.uniform(*LIVES_S)
                until(lambda s=watched_s: shown.listen() or time.monotonic() > s)
                file, killed_ns = written(stem), dive.clock.now_ns()
                dive.kill(name)
                if name == "twin":
                    lost_s.append((killed_ns - newest_ns(file)) * 1e-9)
                else:
                    result = recover(file)
                    assert result.out is not None and sum(result.messages.values()) == len(list(read(result.out)))
                    lost_s.append((killed_ns - newest_ns(result.out)) * 1e-9)
                    mended.append(result.out)
                start(name)
            verdicts = [result.verdict for file in mended if name == "r1" for result in check([file]).results]
            same = verdicts.count("identical")
            figure = f"lost {max(lost_s):.2f} s at most, {statistics.median(lost_s):.2f} s in the middle; well again"
            figure += f"; {same} of {len(verdicts)} files replay byte for byte" if verdicts else ""
            what = f"SIGKILL of the {'agent' if name == 'r1' else name}"
            ok = max(lost_s) < LOST_S and same == len(verdicts)
            yield Row(what, KILLS, figure, f"{LOST_S:.0f} s", ok)
        dive.end()


def newest_ns(file: Path) -> int:
    """The newest moment in it; 0: nothing yet."""
    return max((channel.last_ns for channel in info(file).channels.values()), default=0)
