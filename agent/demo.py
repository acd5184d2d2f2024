"""`aucamp demo`: the paper's localization experiment on the twin, through real processes.

Calibrate each camera on the twin's bench, start the twin, a recorder and one agent per robot, watch what they say
until they have settled, stop everything, and only then look at the truth.
"""

from __future__ import annotations

import json
import math
import os
from collections import deque
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import msgspec
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.live import Live
from rich.table import Table

from agent.clock import machine
from agent.console_log import hears
from agent.fleet_clock import fleet_clock
from agent.fleet_files import fleet_file, shipped_fleet
from agent.kernel.codec import Refusal, decode
from agent.kernel.config import Access, ConfigError, Fleet, Protocol
from agent.kernel.fleet_reader import load_fleet
from agent.kernel.messages import State, fault_kind
from agent.kernel.toml_files import dump
from agent.kernel.topics import STATE
from agent.keys.make import FOLDER, make_keys
from agent.keys.robot_keys import VARIABLE
from agent.launch import Crew, crew, free_ports, wait_for
from agent.progress import with_spinner
from agent.run_folder import run_folder, temporary_folder
from agent.summary import Histories, History, settled, summarize
from agent.transport import Observer
from hw.twin.devices.twin_folder import twin_dir

CALIBRATE_S = 120.0  # a bench that takes longer is stuck; it needs about ten seconds
READY_S = 120.0  # the first start compiles the twin's kernels
SETTLE_ITERATIONS = 30  # after the last robot's first view
SETTLE_WINDOW = 10
SETTLE_M = 0.0015
FAULT_WIDTH = len("telemetry,")  # of the longest word in a fault: narrower, and the reason is cut off


def demo(
    robots: int,
    protocol: Protocol,
    loss: float,
    seed: int,
    duration_s: float,
    enhance: bool,
    out: Path | None,
    console: Console,
    fleet_name: str = "tank",
    speed: float = 1.0,
) -> tuple[Path, dict[str, Any]]:
    """Run the experiment; returns its folder and the content of summary.json. Raises ConfigError and Failed.

    `fleet_name`: a fleet file, or the name of one that comes with the package. `speed`: of the dive's clock against the
    wall's, at most.

    The robots sign with keys of this run, which go with its temporary folder: they are good for nothing else, a run's
    folder is given to others, and may lie where files have no modes. The fleet file as used names the folder `keys`
    beside it, where whoever wants to run it again puts new ones.
    """
    started_s = machine.monotonic_s()
    with temporary_folder() as folder:
        fleet = demo_fleet(robots, protocol, loss, seed, enhance, folder, fleet_file(fleet_name))
        fleet_clock(fleet)  # refuses a fleet of two worlds before anything is calibrated
        fleet = msgspec.structs.replace(fleet, access=Access(keys=FOLDER))
        make_keys(fleet.robot, folder / FOLDER)
        run = run_folder(out)
        path = run / "fleet.toml"
        path.write_text(dump(fleet), encoding="utf-8")
        with crew(run / "logs", {VARIABLE: str(folder / FOLDER)}) as processes:
            calibrate(fleet, path, processes, console)
            histories, truth = dive(fleet, path, run, duration_s, speed, processes, console)
    summary = summarize(fleet, histories, truth, machine.monotonic_s() - started_s)
    (run / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    for target in summary["targets"]:
        console.print(result_table(summary, target))
    console.print(f"{summary['verdict']}: {'; '.join(summary['reasons']) or 'all below 0.4 %'}. Written to {run}")
    return run, summary


def demo_fleet(
    robots: int,
    protocol: Protocol,
    loss: float,
    seed: int,
    enhance: bool,
    folder: Path,
    path: Path | None = None,
) -> Fleet:
    """A fleet file, that of the tank if not given, with its first robots only, on ports that are free now.

    It signs nothing: the keys that the file names are of other computers.
    """
    path = path or shipped_fleet()
    fleet = load_fleet(path)
    if not 1 <= robots <= len(fleet.robot):
        raise ConfigError(f"--robots {robots}: {path.name} has {len(fleet.robot)}; choose 1 to {len(fleet.robot)}")
    if boxes := [name for name, target in fleet.target.items() if target.detector == "box"]:
        raise ConfigError(f"{path.name}: the demo judges places of balls alone; remove the target '{boxes[0]}'")
    names = list(fleet.robot)[:robots]
    ports = free_ports(robots)
    kept = {
        name: msgspec.structs.replace(
            fleet.robot[name],
            neighbours=tuple(n for n in fleet.robot[name].neighbours if n in names),
            listen=f"tcp/127.0.0.1:{port}",
        )
        for name, port in zip(names, ports, strict=True)
    }
    replace = msgspec.structs.replace
    return replace(
        fleet,
        robot=kept,
        access=Access(),
        estimation=replace(fleet.estimation, protocol=protocol),
        link=replace(fleet.link, loss=loss, loss_seed=seed),
        camera=replace(fleet.camera, enhance=enhance),
        twin=replace(fleet.twin, seed=seed, dir=str(folder)),
    )


def calibrate(fleet: Fleet, path: Path, processes: Crew, console: Console) -> None:
    """Each robot's camera and gimbal on the twin's bench.

    Bench and procedure wait for each other: a robot keeps one core busy. One robot more than there are cores leaves
    none idle when the robots are not a multiple of them.
    """
    at_once, running = (os.cpu_count() or 1) + 1, deque[str]()
    with with_spinner(console, f"calibrating on the twin's bench: {', '.join(fleet.robot)}"):
        for name, robot in fleet.robot.items():
            if len(running) == at_once:
                processes.finish(running.popleft(), CALIBRATE_S)
            out = path.parent / robot.calibration
            running.append(f"calibrate_{name}")
            processes.start(running[-1], "calibrate", "run", str(path), "--robot", name, "--out", str(out))
        for process in running:
            processes.finish(process, CALIBRATE_S)


def dive(
    fleet: Fleet, path: Path, run: Path, duration_s: float, speed: float, processes: Crew, console: Console
) -> tuple[Histories, dict[str, Any]]:
    """Twin, recorder and agents until they settle or time is up; returns what they showed, and the truth."""
    folder = twin_dir(fleet)
    with with_spinner(console, "starting the twin"):
        processes.start("twin", "twin", str(path), "--speed", "max" if speed == math.inf else str(speed))
        wait_for("the twin", (folder / "ready").exists, processes, READY_S)
    twin_log = run / "logs" / "twin.log"
    console.print(twin_log.read_text(encoding="utf-8").strip())
    truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    processes.start("recorder", "record", str(path), "--out", str(run / "fleet.mcap"))
    for name in fleet.robot:
        processes.start(name, "agent", str(path), "--robot", name, "--out", str(run), "--arm")
    histories: Histories = {target: {name: History([]) for name in fleet.robot} for target in fleet.target}
    shown = [history for of_target in histories.values() for history in of_target.values()]
    clock = fleet_clock(fleet)
    start_ns = clock.now_ns()
    until_ns = start_ns + round(duration_s * 1e9)
    console.print(
        f"diving until the robots have settled, at most {duration_s:.0f} s; what they say is in {run / 'logs'}"
    )
    live = Live(console=console, refresh_per_second=2) if console.is_terminal else None
    with Observer(fleet, clock.now_ns, (STATE,)) as observer, live or nullcontext():
        while (now_ns := clock.now_ns()) < until_ns:
            for seen in observer.drain():
                try:
                    state = decode(seen.payload, State)
                    histories[state.target][seen.chunks["robot"]].states.append(state)
                except (Refusal, KeyError):
                    continue  # a stranger's sample: the recorder has it
            if live is not None:
                live.update(progress_table(histories, (now_ns - start_ns) * 1e-9, duration_s, clock.rate()))
            if settled(shown, SETTLE_ITERATIONS, SETTLE_WINDOW, SETTLE_M):
                break
            processes.check()
            machine.sleep(0.1)
    if not console.is_terminal:
        console.print()  # a table that was drawn once, into a pipe, has no end of line
    processes.stop(*fleet.robot)
    for complaint in processes.stop("recorder"):
        console.print(complaint, style="red", markup=False)
    processes.stop("twin")
    for complaint in twin_log.read_text(encoding="utf-8").splitlines()[1:]:
        console.print(complaint)
    return histories, truth


def progress_table(histories: Histories, dive_s: float, duration_s: float, rate: float) -> Table:
    """What each robot says of itself and of each target now, in 80 columns."""
    table = Table(
        title=f"{dive_s:.0f} s into the dive, at {rate:.2f} times real time; at most {duration_s - dive_s:.0f} s to go",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        show_edge=False,
    )
    for column in ("target", "robot", "", "iter.", "saw at", "estimate mm", "± mm", "hears", "faults"):
        least = FAULT_WIDTH if column == "faults" else len(column)
        table.add_column(column, no_wrap=column not in ("hears", "faults"), min_width=least)
    for target, of_target in histories.items():
        for name, history in of_target.items():
            table.add_row(target, name, *progress_row(history.newest))
    return table


def progress_row(state: State | None) -> tuple[str, ...]:
    """The cells behind target and robot."""
    if state is None:
        return ("…",)
    return (
        state.knows,
        str(state.t),
        "-" if state.acquired_t is None else str(state.acquired_t),
        " ".join(f"{1e3 * x:.1f}" for x in state.posterior_m) if state.posterior_m else "-",
        f"{1e3 * state.posterior_sigma_m:.1f}" if state.posterior_sigma_m else "-",
        " ".join(hears(state)) or "-",
        ", ".join(map(fault_kind, state.faults)) or ("motors off" if state.armed is False else ""),
    )


def result_table(summary: dict[str, Any], target: str) -> Table:
    """Prior and posterior of one target against the truth, mm in x, y and z."""
    about = summary["targets"][target]
    place = ", ".join(f"{x:g}" for x in about["truth_m"])
    table = Table(
        title=f"{target} at ({place}) m, protocol {summary['protocol']}, twin seed {summary['seed']}",
        title_justify="left",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
    )
    for column in ("robot", "saw at", "iterations", "prior rms mm", "posterior error mm", "3-D", "%"):
        table.add_column(column, justify="right", no_wrap=True)
    for name, row in about["agents"].items():
        table.add_row(
            name,
            "never" if row["acquired_iteration"] is None else str(row["acquired_iteration"]),
            str(row["iterations"]),
            " ".join(f"{v:.1f}" for v in row["prior_rmse_axis_mm"] or []),
            " ".join(f"{v:+.1f}" for v in row["error_axis_mm"] or []),
            f"{row['error_mm']:.2f}" if row["error_mm"] is not None else "-",
            f"{row['relative_error_percent']:.2f}" if row["relative_error_percent"] is not None else "-",
        )
    return table
