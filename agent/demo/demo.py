"""`aucamp demo`: the paper's localization experiment on the twin, through real processes: its fleet, where robots
listen, the page, and the dive itself.

Calibrate each camera on the twin's bench, start the twin, a recorder and one agent per robot, watch what they say
until they have settled, stop everything, and only then look at the truth.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import shutil
import socket
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from rich.console import Console
from rich.live import Live

from agent.clock import machine
from agent.core.capability_messages import Claim
from agent.core.codec import Refusal
from agent.core.config import Access, ConfigError, Fleet, Protocol, dump, write_whole
from agent.core.robot_view import in_own_name
from agent.core.topics import CLAIM, STATE
from agent.demo.display import how_to_look, progress_table, progress_title, result_table, survey_table
from agent.demo.summary import (
    FOLLOW_S,
    Histories,
    History,
    SurveyWatch,
    followed_s,
    is_box,
    scored,
    settled,
    summarize,
    swims,
    whereabouts,
    whereabouts_lines,
)
from agent.ground.new_fleet import FOLDER, make_all
from agent.ground.page.server import PORT, websockets_or_why
from agent.perception.detection.detectors import target_picture
from agent.perception.tracking.follow import load_box_tracker, model_files
from agent.process.command import (
    Failed,
    fleet_file,
    run_folder,
    shipped_fleet,
    temporary_folder,
    with_pictures,
    with_spinner,
)
from agent.process.keys import VARIABLE
from agent.process.launch import Crew, crew, free_ports, is_free, wait_for
from agent.process.transport import Observer, fleet_clock
from agent.robot.arbiter import refuse_broken
from agent.robot.fleet_reader import load_fleet
from hw.twin.dive import playable
from hw.twin.scene import scene_of, target_creatures, target_solids
from hw.twin.twin_folder import twin_dir

# --- the fleet ---
# The fleet of a demo: the first robots of a fleet file, all in the twin, which knows the places of their targets.

T = TypeVar("T", bound=msgspec.Struct)
CONSOLE = "ann"  # who may order in a secured demo whose file names nobody
OF_THE_TANK = 3  # of its five robots, unless more are asked for: two cores render no more cameras at real time


def demo_fleet(
    robots: int | None,
    protocol: Protocol | None,
    loss: float | None,
    seed: int | None,
    enhance: bool | None,
    folder: Path,
    path: Path | None = None,
) -> Fleet:
    """A fleet file, that of the tank if not given, with its first robots only, on ports that are free now.

    `robots`: None for all of the file, of the tank three; of `protocol`, `loss`, `seed` and `enhance` None is what the
    file has. `folder` is the twin's. It signs nothing: the keys that the file names are of other computers. Raises
    ConfigError for what cannot dive in the twin, or not be judged there.
    """
    path = path or shipped_fleet()
    fleet = load_fleet(path)
    refuse_broken(fleet)  # before a minute of calibrations
    names = _first(fleet, robots, path)
    _lives_in_the_twin(fleet, names, path)
    _has_its_targets(fleet, names, path)
    if fleet.coverage is not None and len(names) == 1:
        raise ConfigError(
            f"{path.name}: a survey is judged by what robots tell each other of it, so that it takes two; --robots 2"
        )
    kept = {
        name: msgspec.structs.replace(
            fleet.robot[name], neighbours=tuple(n for n in fleet.robot[name].neighbours if n in names)
        )
        for name in names
    }
    replace = msgspec.structs.replace
    fleet = replace(
        fleet,
        robot=kept,
        access=Access(),
        estimation=_with(fleet.estimation, protocol=protocol),
        link=_with(fleet.link, loss=loss, loss_seed=seed),
        camera=_with(fleet.camera, enhance=enhance),
        twin=_with(fleet.twin, seed=seed, dir=str(folder)),
    )
    return listening(fleet, [f"tcp/127.0.0.1:{port}" for port in free_ports(len(names))])


def listening(fleet: Fleet, endpoints: list[str]) -> Fleet:
    """The fleet, its robots listening on these endpoints in the order of the file."""
    robots = {
        name: msgspec.structs.replace(robot, listen=endpoint)
        for (name, robot), endpoint in zip(fleet.robot.items(), endpoints, strict=True)
    }
    return msgspec.structs.replace(fleet, robot=robots)


def with_access(fleet: Fleet, consoles: tuple[str, ...], secure: bool) -> Fleet:
    """The fleet, signing with keys of its run; `secure`: with certificates too, and a console at the least."""
    if secure:
        endpoints = ["tls/" + robot.listen.partition("/")[2] for robot in fleet.robot.values()]
        fleet, consoles = listening(fleet, endpoints), consoles or (CONSOLE,)
    return msgspec.structs.replace(fleet, access=Access(keys=FOLDER, consoles=consoles))


def _with(table: T, **asked: object) -> T:
    """A table of the file, but for what was asked for."""
    return msgspec.structs.replace(table, **{name: value for name, value in asked.items() if value is not None})


def _first(fleet: Fleet, robots: int | None, path: Path) -> list[str]:
    """Names of the robots that dive."""
    all_names = list(fleet.robot)
    if robots is None:
        return all_names[: OF_THE_TANK if path == shipped_fleet() else None]
    if not 1 <= robots <= len(all_names):
        raise ConfigError(f"--robots {robots}: {path.name} has {len(all_names)}; choose 1 to {len(all_names)}")
    return all_names[:robots]


def _lives_in_the_twin(fleet: Fleet, names: list[str], path: Path) -> None:
    for name in names:
        devices: Mapping[str, str] = {"serial": fleet.robot[name].serial, "camera": fleet.robot[name].camera}
        for key, device in devices.items():
            if device != f"twin:{name}":
                raise ConfigError(
                    f"{path}: key 'robot.{name}.{key}': '{device}' is not in the twin, where the demo dives; "
                    f'write "twin:{name}" in a copy of the file, or start the robots with aucamp agent'
                )


def _has_its_targets(fleet: Fleet, names: list[str], path: Path) -> None:
    """The scene has all targets, these robots can dive in it, and what tells targets that are no ball can be used."""
    scene = scene_of(fleet)
    known = {*target_solids(fleet, scene, path), *target_creatures(fleet, scene, path)}
    for name, target in fleet.target.items():
        if name not in known:
            raise ConfigError(
                f"{path}: key 'target.{name}': nothing in scene '{scene.name}' has this name, so that nobody could "
                f'judge the estimates; write name = "{name}" under a [[solid]] or [[creature]] of the scene file'
            )
        if target.picture is not None:
            target_picture(name, target, (fleet.camera.width_px, fleet.camera.height_px))
        if target.models is not None:
            load_box_tracker(model_files(Path(target.models)))
    playable(fleet, scene, names)


# --- endpoints ---
# Where the robots of a demo listen: where their fleet file says if that is free, else on other ports.
#
# A demo binds its ports only when it has calibrated its cameras. Until then nothing shows that they are taken. So it
# also holds a name for each, which the kernel forgets with the process: an abstract Unix socket (Linux, unix(7)),
# which belongs to a network namespace as ports do. Where there are no such names, a demo takes free ports.

NAMES = sys.platform == "linux"


@contextlib.contextmanager
def reserved(wished: Sequence[str]) -> Iterator[list[str]]:
    """These endpoints where all of them are free, else as many on free ports of this computer; no other demo takes
    them before the block ends. Raises Failed where there are not so many."""
    with contextlib.ExitStack() as held:
        endpoints, first = list(wished), None
        while not (NAMES and all(map(is_free, endpoints)) and _hold(endpoints, held)):
            ports = free_ports(len(wished), first)
            endpoints, first = [f"tcp/127.0.0.1:{port}" for port in ports], ports[-1] + 1
            if not NAMES:
                break
        yield endpoints


def _hold(endpoints: Sequence[str], held: contextlib.ExitStack) -> bool:
    """Whether the names of all are ours now, until `held` is closed."""
    with contextlib.ExitStack() as ours:
        for endpoint in endpoints:
            try:
                ours.enter_context(socket.socket(socket.AF_UNIX)).bind(f"\0aucamp {endpoint}")
            except OSError:  # another demo's, or too long for a name
                return False
        held.enter_context(ours.pop_all())
    return True


# --- the page ---
# The page of a demo: a process of its own, as a user would start it, and where it is to be opened.

PAGE_READY_S = 60.0  # of the wall
ME = "me"  # as whom orders are given where the fleet file names nobody: on one computer everybody may


def open_page(fleet: Fleet, path: Path, processes: Crew) -> str:
    """Start it; returns the line that says where to look. Raises Failed, and ConfigError without the extra `page`."""
    with websockets_or_why():
        import websockets  # noqa: F401 - the process would say it in its log alone
    port = PORT if is_free(f"tcp/127.0.0.1:{PORT}") else free_ports(1)[0]
    console = next(iter(fleet.access.consoles), ME)
    log = path.parent / "logs" / "page.log"
    processes.start("page", "page", str(path), "--as", console, "--port", str(port), "--out", str(path.parent))
    wait_for("the page", lambda: "http://" in log.read_text(encoding="utf-8"), processes, PAGE_READY_S)
    address = next(word for word in log.read_text(encoding="utf-8").split() if word.startswith("http://"))
    return f"\nlook at it, and give orders, in a browser on this machine:\n  {address}\n"


# --- the dive ---

CALIBRATE_S = 300.0  # of a processor, or of standing still; a bench needs about ten seconds, and as many on a busy one
READY_S = 300.0  # of the wall; the first start compiles the twin's kernels
SETTLE_ITERATIONS = 30  # after the last robot's first view
SETTLE_WINDOW = 10
SETTLE_M = 0.0015
TRUE_WAYS = ("paths.csv", "separation.json", "creatures.csv", "boxes.csv")  # of all that swims, as the twin leaves them


def demo(
    robots: int | None,
    protocol: Protocol | None,
    loss: float | None,
    seed: int | None,
    duration_s: float,
    out: Path | None,
    console: Console,
    fleet_name: str = "tank",
    speed: float = 1.0,
    secure: bool = False,
    page: bool = False,
    faults: Mapping[str, float] | None = None,
    stale: bool = False,
) -> tuple[Path, dict[str, Any]]:
    """Run the experiment; returns its folder and the content of summary.json. Raises ConfigError and Failed.

    `robots`, `protocol`, `loss`, `seed`: see demo_fleet. `fleet_name`: a fleet file, or the name of one that
    comes with the package. `speed`: of the dive's clock against the wall's, at most. `page`: with a page to look at it
    and to order, until the person who looks has seen enough. `faults`: keys of [twin] as they are to be; `stale`:
    cameras were calibrated before they had them.

    The robots sign with keys of this run, which go with its temporary folder: they are good for nothing else, a run's
    folder is given to others, and may lie where files have no modes. The fleet file as used names the folder `keys`
    beside it, where a person who runs it again puts new ones. `secure`, or a file that is so: all links are TLS.
    """
    started_s = machine.monotonic_s()
    file = fleet_file(fleet_name)
    with ExitStack() as stack:
        folder = stack.enter_context(temporary_folder())
        sound = demo_fleet(robots, protocol, loss, seed, None, folder, file)
        fleet = msgspec.structs.replace(sound, twin=_with(sound.twin, **(faults or {})))
        own = load_fleet(file)
        wished = ["tcp/" + own.robot[name].listen.partition("/")[2] for name in fleet.robot]
        fleet = listening(fleet, stack.enter_context(reserved(wished)))
        fleet = with_access(fleet, own.access.consoles, secure or own.secured)
        make_all(fleet, folder / FOLDER)
        run = run_folder(out)
        path = run / "fleet.toml"
        write_whole(path, dump(with_pictures(fleet, run)))
        stack.enter_context(keeping(run, console))
        processes = stack.enter_context(crew(run / "logs", {VARIABLE: str(folder / FOLDER)}))
        bench = run / "fleet_before.toml" if stale else path
        if stale:
            write_whole(bench, dump(with_pictures(sound, run)))
        calibrate(fleet, bench, processes, console)
        survey = SurveyWatch(fleet) if fleet.coverage is not None else None
        if page:
            console.print(open_page(fleet, path, processes), highlight=False, soft_wrap=True)
        histories, truth = dive(fleet, path, run, duration_s, speed, processes, console, survey, folder / FOLDER, page)
    with with_spinner(console, "reading the recordings"):
        followed = {target: scored(run, fleet, target) for target in fleet.target if swims(fleet, target)}
    summary = summarize(fleet, histories, truth, machine.monotonic_s() - started_s, followed, survey)
    if off := whereabouts(run, histories):
        summary["whereabouts"] = off
    write_whole(run / "summary.json", json.dumps(summary, indent=1) + "\n")
    for target in summary["targets"] if survey is None else ():  # cameras of a survey are not at targets
        console.print(result_table(summary, target))
    for line in survey.lines() if survey is not None else ():
        console.print(line, highlight=False)
    for line in whereabouts_lines(off):
        console.print(line, highlight=False)
    return run, summary


def calibrate(fleet: Fleet, path: Path, processes: Crew, console: Console) -> None:
    """Each robot's camera and gimbal on the twin's bench.

    Bench and procedure wait for each other: a robot keeps one core busy. One robot more than there are cores leaves
    none idle when the robots are not a multiple of them.
    """
    at_once, waiting, robots = (os.cpu_count() or 1) + 1, deque(fleet.robot), len(fleet.robot)
    what = f"calibrating on the twin's bench: {', '.join(fleet.robot)}"
    with with_spinner(console, what) as say:
        for done in range(robots):
            say(f"{what} ({done} of {robots} done)")
            while waiting and robots - len(waiting) - done < at_once:
                name = waiting.popleft()
                out = path.parent / fleet.robot[name].calibration
                processes.start(f"calibrate_{name}", "calibrate", "run", str(path), "--robot", name, "--out", str(out))
            processes.finish_one(CALIBRATE_S)


@contextmanager
def keeping(run: Path, console: Console) -> Iterator[None]:
    """Who ends a run before its time, or meets a failure, is told where its files are."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit):
        console.print(f"interrupted; what there is of this run is in {run}")
        raise
    except Failed as error:
        raise Failed(f"{error}; what there is of this run is in {run}") from None


def dive(
    fleet: Fleet,
    path: Path,
    run: Path,
    duration_s: float,
    speed: float,
    processes: Crew,
    console: Console,
    survey: SurveyWatch | None = None,
    keys: Path | None = None,
    page: bool = False,
) -> tuple[Histories, dict[str, Any]]:
    """Twin, recorder and agents until they settle, or have surveyed, or time is up; returns what they showed, and the
    truth. `keys`: the folder of this run's. Where somebody looks at a `page` the dive ends by time alone, or as he
    interrupts it."""
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
    clock = fleet_clock(fleet)
    start_ns = clock.now_ns()
    until_ns = start_ns + round(duration_s * 1e9)
    for line in how_to_look(fleet, path, keys):
        console.print(line, highlight=False)
    ends = f"know where it is and {until(fleet)}" if survey is None else "know what is asked for, and the same"
    console.print(
        f"diving until Ctrl-C, at most {duration_s:.0f} s; then comes the report; logs are in {run / 'logs'}"
        if page
        else f"diving until all robots {ends}, at most {duration_s:.0f} s; Ctrl-C ends it; logs are in {run / 'logs'}"
    )
    live = Live(console=console, refresh_per_second=2) if console.is_terminal else None
    with (
        Observer(fleet, clock.now_ns, (STATE,) if survey is None else (STATE, CLAIM), keys=keys) as observer,
        live or nullcontext(),
        suppress(KeyboardInterrupt) if page else nullcontext(),
    ):
        while (now_ns := clock.now_ns()) < until_ns:
            for seen in observer.drain():
                try:
                    said = in_own_name(seen.topic, seen.chunks, seen.payload)
                    if survey is not None and isinstance(said, Claim):
                        survey.add(said)
                    else:
                        histories[said.target][said.robot].states.append(said)
                except (Refusal, KeyError):
                    continue  # a stranger's sample: the recorder has it
            if live is not None:
                title = progress_title((now_ns - start_ns) * 1e-9, duration_s, clock.rate())
                live.update(
                    progress_table(histories, title) if survey is None else survey_table(histories, survey, title)
                )
            settled_all = all(settled_on(fleet, target, of_target) for target, of_target in histories.items())
            if not page and (settled_all if survey is None else survey.over):
                break
            processes.check()
            machine.sleep(0.1)
    if not console.is_terminal:
        console.print()  # a table that was drawn once, into a pipe, has no end of line
    processes.stop(*fleet.robot)
    for complaint in processes.stop("recorder", *(["page"] if page else [])):
        console.print(complaint, style="red")
    processes.stop("twin")
    for complaint in twin_log.read_text(encoding="utf-8").splitlines()[1:]:
        console.print(complaint)
    for true in TRUE_WAYS:
        if (folder / true).exists():
            shutil.copy(folder / true, run)
    return histories, truth


def settled_on(fleet: Fleet, target: str, of_target: Mapping[str, History]) -> bool:
    """Whether nothing more is to be expected about this target. A thing in a box need not be seen by all; what swims
    has been followed for long enough."""
    if swims(fleet, target):
        return followed_s(of_target) >= FOLLOW_S
    return settled(of_target.values(), SETTLE_ITERATIONS, SETTLE_WINDOW, SETTLE_M, all_see=not is_box(fleet, target))


def until(fleet: Fleet) -> str:
    """What a dive waits for, in words."""
    moving = [swims(fleet, target) for target in fleet.target]
    words = ([] if all(moving) else ["have settled"]) + (
        [f"have followed it for {FOLLOW_S:.0f} s"] if any(moving) else []
    )
    return " and ".join(words)
