"""A running fleet from outside: `aucamp snapshot`, the next picture that a robot shows; `aucamp watch`, a line for each
robot; `aucamp record` and `aucamp view`, also of several fleets at once.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from threading import Event
from typing import NamedTuple, TypeVar

import tomli_w
from msgspec import UNSET

from agent.clock import machine
from agent.core.codec import Refusal, printable
from agent.core.config import NAME_RULE, ConfigError, Fleet
from agent.core.messages import NAME, Image, State
from agent.core.robot_view import in_own_name, robot_view
from agent.core.topics import IMAGE, STATE
from agent.ground.bridges.outward import own_word
from agent.process.certificates import credentials
from agent.process.command import Failed, new_recording
from agent.process.keys import VARIABLE
from agent.process.transport import Observer, fleet_clock
from agent.robot.fleet_reader import load_fleet
from replay.recorder import record, view

HEARD_S = 3.0  # of the wall: states come five times a second, and a link is there in less than one
PICTURE_S = 10.0  # between two sweeps a whole frame is seldom further away, also in a dive at a quarter of its speed
LOOK_S = 0.02
WATCH_S = 0.5  # between two looks of a person


def next_picture(fleet: Fleet, robot: str, keys: Path | None = None) -> Image:
    """The robot's next preview. Raises Failed, one line that says what is wrong, where none comes.

    `keys`: folder of a secured fleet's certificates.
    """
    state, refused, start_s = None, "", machine.monotonic_s()
    with Observer(fleet, machine.monotonic_ns, (IMAGE, STATE), keys=keys) as observer:
        while (waited_s := machine.monotonic_s() - start_s) < PICTURE_S:
            for seen in observer.drain():
                if seen.chunks["robot"] != robot:
                    continue
                try:
                    said = in_own_name(seen.topic, seen.chunks, seen.payload)
                except Refusal as refusal:
                    refused = str(refusal)
                    continue
                if isinstance(said, Image):
                    return said
                state = said
            if waited_s > HEARD_S and (why := hopeless(fleet, robot, state, refused)):
                raise Failed(why)
            machine.sleep(LOOK_S)
    raise Failed(
        f"{robot} is heard, but showed no picture in {PICTURE_S:.0f} s: while it sweeps its lens it reads parts of "
        f"frames alone; try again"
    )


def hopeless(fleet: Fleet, robot: str, state: State | None, refused: str) -> str:
    """Why no picture is to be expected; empty: it may still come."""
    if state is None and refused:
        return (
            f"{robot} is heard, but its messages cannot be read ({refused}); use the same version of aucamp as it has"
        )
    if state is None:
        where = fleet.robot[robot].listen
        return (
            f"{robot} is not heard at {where}: start its agent, or give the fleet file that it was started with "
            f"(a demo's is in its run's folder)"
        )
    if fleet.link.preview_hz == 0:
        return f"{robot} is heard, but shows no pictures: [link] preview_hz is 0; set it, and start the agent again"
    blind = "; ".join(robot_view(state).blind)
    return f"{robot} is heard, but has no picture: {blind}" if blind else ""


def about(path: Path, image: Image) -> str:
    """The picture in one line."""
    lens = "lens position not known" if image.focus is None else f"lens position {image.focus}"
    made = "enhanced" if image.enhanced else "as the camera gave it"
    return (
        f"{path}: frame {image.frame} of {image.robot}, {image.width_px}x{image.height_px} pixels, "
        f"{len(image.jpeg) / 1e3:.0f} kB, {lens}, {made}"
    )


def check_target(name: str, fleet: Fleet) -> None:
    """Raises ConfigError for a name that the fleet file does not take, or has already."""
    if not NAME.fullmatch(name):
        raise ConfigError(f"--target {printable(name)}: {NAME_RULE}; give another name")
    if name in fleet.target:
        raise ConfigError(f"--target {name}: the fleet file has a target of that name; give another name")


def target_table(fleet: Fleet, name: str, path: Path, image: Image) -> str:
    """What to put into the fleet file so that robots look for a thing in this picture. Raises Failed for a picture
    that is none for that."""
    if image.enhanced:
        raise Failed(f"{path}: enhanced, and robots look at raw frames; set [camera] enhance = false and take another")
    if (image.width_px, image.height_px) != (fleet.camera.width_px, fleet.camera.height_px):
        raise Failed(
            f"{path}: a preview of {image.width_px}x{image.height_px} pixels, and a target needs the camera's full "
            f"{fleet.camera.width_px}x{fleet.camera.height_px}; take the picture with another program"
        )
    return (
        f"\n[target.{name}]\n"
        'detector = "box"\n'
        f"{tomli_w.dumps({'picture': path.name}).strip()}   # beside the fleet file\n"
        "box = [X, Y, WIDTH, HEIGHT]   # around the thing in it: pixels from the upper left corner"
    )


# --- watch ---
# `aucamp watch`: a line for each robot of a fleet, written anew as states come.

SILENT_S = 2.0  # without a state: ten of them
WORDS = 3  # faults in a line


def watch(fleet: Fleet, keys: Path | None, stop: Event, show: Callable[[list[str]], None]) -> None:
    """Show the lines of all robots, in the order of the fleet file, each WATCH_S until `stop` is set."""
    heard: dict[str, tuple[State, float]] = {}
    with Observer(fleet, machine.monotonic_ns, (STATE,), keys=keys) as observer:
        while not machine.wait(stop, WATCH_S):
            for seen in observer.drain():
                if isinstance(said := own_word(seen), State):
                    heard[said.robot] = said, machine.monotonic_s()
            now_s = machine.monotonic_s()
            show([line_of(name, fleet, heard.get(name), now_s) for name in fleet.robot])


def line_of(robot: str, fleet: Fleet, heard: tuple[State, float] | None, now_s: float) -> str:
    """What a robot last said, and when, in one line of plain words."""
    if heard is None:
        return f"{robot}  not heard"
    state, heard_s = heard
    view, said = robot_view(state, fleet), [f"{robot}  {state.knows} {state.target}"]
    if state.posterior_m is not None:
        place, sigma_m = " ".join(f"{x_m:.3f}" for x_m in state.posterior_m), state.posterior_sigma_m
        said.append(f"at {place} m" + ("" if sigma_m is None else f" +- {1e3 * sigma_m:.1f} mm"))
        said.append(state.verdict if not state.causes else f"{state.verdict}: {state.causes[0]}")
    if view.body is not None and state.whereabouts is not UNSET:
        said.append(f"itself at {view.body.x_m:.2f} {view.body.y_m:.2f} m")
    said.append("depth not known" if state.depth_m is None else f"depth {state.depth_m:.2f} m")
    said.append(f"hears {' '.join(view.hears) or 'nobody'}")
    if view.motors:
        said.append(view.motors)
    if state.battery_v is not UNSET:
        said.append(f"{state.battery_v:.1f} V")
    said += state.faults[:WORDS]
    if now_s - heard_s > SILENT_S:
        said.append(f"silent for {now_s - heard_s:.0f} s")
    return "  ".join(map(printable, said))


# --- several fleets at once ---
# Several fleets looked at by one process: a thread for each, so that what happens to one stops none of the others.

T = TypeVar("T")
Say = Callable[[str], None]  # a line for a person


def load_fleets(paths: Sequence[Path]) -> dict[Path, Fleet]:
    """All these fleets. Raises ConfigError for a file that is no fleet's, and for two fleets of one name."""
    fleets: dict[Path, Fleet] = {}
    for path in paths:
        fleet = load_fleet(path)
        if (same := next((other for other, known in fleets.items() if known.fleet == fleet.fleet), None)) is not None:
            raise ConfigError(
                f"{path}: fleet '{fleet.fleet}', as {same} is; give each fleet a name of its own (key 'fleet'), or "
                f"look at them by two commands"
            )
        fleets[path] = fleet
    return fleets


def keys_of(fleets: Mapping[Path, Fleet], name: str) -> dict[Path, Path | None]:
    """The folder of each secured fleet's certificates, in which `name` has one. Raises ConfigError.

    The variable AUCAMP_KEYS names one folder, and each fleet has an authority of its own.
    """
    if len(fleets) > 1 and VARIABLE in os.environ and any(fleet.secured for fleet in fleets.values()):
        raise ConfigError(f"{VARIABLE} names the keys of one fleet; unset it: each fleet file says where its own are")
    return {path: credentials(fleet, name, path) for path, fleet in fleets.items()}


def recordings_of(fleets: Sequence[Fleet], out: Path) -> dict[str, Path]:
    """Where each fleet is recorded, by its name: a file, or of several a file each in a folder.

    Raises ConfigError where something is there already.
    """
    if len(fleets) == 1:
        return {fleets[0].fleet: new_recording(out)}
    if out.suffix == ".mcap":
        raise ConfigError(f"--out {out}: each of several fleets has a recording of its own; give --out a folder")
    files = {fleet.fleet: new_recording(out / f"{fleet.fleet}.mcap") for fleet in fleets}
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{out}: cannot be made ({error.strerror}); give --out another folder") from None
    return files


def at_once(jobs: Mapping[str, Callable[[Say], T]], stop: Event, say: Say) -> tuple[dict[str, T], list[str]]:
    """Do all of this until each has ended, which `stop` tells them to; returns by fleet what came of it, and lines
    about those that could not go on.

    Each job is given a `say` for its lines, which names its fleet. One that raises ConfigError has ended: that is said
    at once, and the others go on. Whatever else a job raises ends all of them. A job alone is simply done: its lines
    name no fleet, and what it raises is raised.
    """
    if len(jobs) == 1:
        return {name: job(say) for name, job in jobs.items()}, []
    done: dict[str, T] = {}
    failed: list[str] = []

    def do(name: str, job: Callable[[Say], T]) -> None:
        def of_fleet(line: str) -> None:
            say(f"fleet '{name}': {line}")

        try:
            done[name] = job(of_fleet)
        except ConfigError as error:
            failed.append(f"fleet '{name}': {error}")
            say(failed[-1])
        except BaseException:
            stop.set()
            raise

    with ThreadPoolExecutor(len(jobs)) as pool:
        for running in [pool.submit(do, name, job) for name, job in jobs.items()]:
            running.result()
    return {name: done[name] for name in jobs if name in done}, failed


# --- record ---
# `aucamp record`: one fleet into a file, or several, each into a file of its own, by one process.


class Recorded(NamedTuple):
    """What came of it, in lines for a person."""

    done: list[str]
    failed: list[str]


def record_fleets(paths: Sequence[Path], out: Path, stop: Event, say: Say) -> Recorded:
    """Record until `stop` is set; `say` gets lines meanwhile.

    Of several fleets one that cannot be recorded any longer ends no other's recording. Raises ConfigError for files and
    folders that cannot be used, and where the only fleet cannot be recorded.
    """
    fleets = load_fleets(paths)
    keys = keys_of(fleets, "recorder")
    clocks = {path: fleet_clock(fleet) for path, fleet in fleets.items()}
    files = recordings_of(tuple(fleets.values()), out)
    jobs = {
        fleet.fleet: partial(record, fleet, files[fleet.fleet], stop, clocks[path], keys=keys[path])
        for path, fleet in fleets.items()
    }
    several = len(jobs) > 1
    say(f"recording fleet{'s' * several} {', '.join(repr(name) for name in jobs)}; Ctrl-C ends it")
    recorded, failed = at_once(jobs, stop, say)
    done = []
    for name, counts in recorded.items():
        if any(counts.values()):
            listed = "recorded: " + ", ".join(f"{kind} {count}" for kind, count in counts.items() if count)
            done.append(f"fleet '{name}': {listed}" if several else listed)
        else:
            failed.append(f"nobody of fleet '{name}' was heard, so {files[name]} was not kept: nothing is in it")
    return Recorded(done, failed)


# --- view ---
# `aucamp view`: one fleet in Foxglove, or several, each at a port of its own, by one process.


def view_fleets(paths: Sequence[Path], port: int, stop: Event, say: Say) -> None:
    """Serve until `stop` is set, the first fleet at `port`, the next at the next; `say` gets lines for a person.

    Of several fleets one that cannot be served ends no other's view; at the end Failed is raised. Raises ConfigError
    for files that cannot be used, and where the only fleet cannot be served.
    """
    fleets = load_fleets(paths)
    keys = keys_of(fleets, "view")
    jobs = {
        fleet.fleet: partial(view, fleet, stop, fleet_clock(fleet), at, keys=keys[path])
        for at, (path, fleet) in enumerate(fleets.items(), start=port)
    }
    _, failed = at_once(jobs, stop, say)
    if failed:
        raise Failed("; ".join(failed))
