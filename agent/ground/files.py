"""The files that a robot needs beside the fleet file: calibration, keys, pictures of its targets, room to record."""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Iterator
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from agent.core.config import ConfigError, Fleet, Target
from agent.ground.addresses import is_here
from agent.ground.finding import Finding, tried
from agent.perception.detection.detectors import colours_too_alike, creature_hues, sought, target_picture
from agent.perception.tracking.box import Box
from agent.perception.tracking.box_trackers import load_box_tracker, model_files
from agent.perception.tracking.follow import check_box
from agent.process.agent_process import own_calibration
from agent.process.key_files import private_file
from agent.process.key_folder import read_keys
from agent.process.robot_keys import keys_folder, robot_keys
from hw.twin.scene import scene_of
from hw.twin.targets import target_solids
from replay.files.log import Limits

OPEN_FILES = 1024  # that a process may have at once: fifty links in full mesh took 119 of them
HOUR_BYTES = 1.2e9  # what a robot records in an hour, at most: 30 MB in the 90 s of a demo


def calibration_finding(fleet: Fleet, name: str, path: Path) -> Finding:
    """The camera's calibration. One of the twin is made by each demo for itself."""

    def read() -> str:
        made = own_calibration(fleet, name, path)
        return f"{fleet.robot[name].calibration}, made {made.made}"

    in_twin = fleet.robot[name].camera.startswith("twin:")
    absent = not (path.parent / fleet.robot[name].calibration).exists()
    found = tried(name, read, otherwise="warning" if in_twin and absent else "wrong")
    return found._replace(text=f"{found.text} (a demo makes its own)") if found.level == "warning" else found


def key_findings(fleet: Fleet, name: str, path: Path) -> Iterator[Finding]:
    """The robot's own keys, and those of the others."""
    folder = keys_folder(fleet, path)
    if folder is None:
        return

    def read() -> str:
        robot_keys(fleet, name, path)
        return f"keys in {folder}"

    yield tried(name, read)
    foreign = [other for other in fleet.robot if other != name and private_file(folder, other).exists()]
    if foreign and any(not is_here(fleet.robot[other].listen) for other in foreign):
        text = f"{folder}: holds private keys of {', '.join(foreign)}, for whom this computer can speak; remove them"
        yield Finding("warning", name, text)
    missing = [other for other in read_keys(folder, fleet.robot).missing if other != name]
    if missing:
        text = f"{folder}: no public key of {', '.join(missing)}, of whom nothing is believed; copy NAME.sign.pub there"
        yield Finding("warning", name, text)


def target_findings(fleet: Fleet) -> Iterator[Finding]:
    """Pictures and models of targets, and whether balls are told apart by their colours."""
    size = fleet.camera.width_px, fleet.camera.height_px
    balls_can_be_read = True
    for name, target in fleet.target.items():
        if target.detector == "box":
            yield tried(f"target {name}", partial(box_target, name, target, size))
        elif target.picture is not None:
            sample = creature_sample if target.detector == "creature" else ball_sample
            found = tried(f"target {name}", partial(sample, name, target, size))
            balls_can_be_read &= found.level == "ok"
            yield found
    if balls_can_be_read:
        yield from (Finding("warning", "fleet", line) for line in colours_too_alike(fleet))


def ball_sample(name: str, target: Target, size: tuple[int, int]) -> str:
    """Raises ConfigError, as the agent does at its start."""
    sought(name, target, size)
    return f"its colour is that of the box in {target.picture}"


def creature_sample(name: str, target: Target, size: tuple[int, int]) -> str:
    """Raises ConfigError, as the agent does at its start."""
    creature_hues(name, target, size)
    return f"its colour is that of the box in {target.picture}"


def box_target(name: str, target: Target, size: tuple[int, int]) -> str:
    """Raises ConfigError, as the agent does at its start."""
    target_picture(name, target, size)
    check_box(Box(*(target.box or (0, 0, 0, 0))), size)
    load_box_tracker(*((None, None) if target.models is None else model_files(Path(target.models))))
    return f"its picture is {target.picture}"


def twin_findings(fleet: Fleet, path: Path) -> Iterator[Finding]:
    """The scene of a fleet that is in the twin, and whether all targets are in it."""
    if not any(robot.serial.startswith("twin:") for robot in fleet.robot.values()):
        return

    def read() -> str:
        scene = scene_of(fleet)
        lacking = set(fleet.target) - set(target_solids(fleet, scene, path)) - {fish.name for fish in scene.creature}
        if lacking:
            name = min(lacking)
            raise ConfigError(
                f"nothing in scene '{scene.name}' is called {name}, so that a demo could not judge it; write "
                f'name = "{name}" under a [[solid]] or [[creature]] of the scene'
            )
        return f"scene '{scene.name}', in which all targets are"

    yield tried("twin", read)


def enhancement_findings(fleet: Fleet) -> Iterator[Finding]:
    """What `[camera] enhance = true` wants installed."""
    if not fleet.camera.enhance:
        return
    if all(find_spec(package) for package in ("torch", "safetensors")):
        yield Finding("ok", "fleet", "[camera] enhance: the network can be used")
    else:
        text = "[camera] enhance: torch is not there, so colours alone are mended"
        yield Finding("warning", "fleet", f"{text}; in your clone: pip install -e '.[enhance]'")


def disk_finding(folder: Path) -> Finding:
    """Whether an agent that is started here can record."""
    if not os.access(folder, os.W_OK):
        text = f"{folder}: you may not write here, where recordings go; give aucamp agent --out another folder"
        return Finding("wrong", "disk", text)
    total, _, free = shutil.disk_usage(folder)
    limits = Limits()
    room = free - min(limits.floor_bytes, limits.floor_share * total)  # an agent leaves so much to others
    hours = f"{free / 1e9:.1f} GB free in {folder}: {room / HOUR_BYTES:.0f} hours of one robot's recording"
    if room <= 0:
        return Finding("wrong", "disk", f"{free / 1e9:.1f} GB free in {folder}: nothing would be recorded; make room")
    return Finding("ok" if room > HOUR_BYTES else "warning", "disk", hours)


def files_finding() -> Finding:
    """Whether a process here may open as many files as an agent with links to a whole fleet does."""
    most, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most != resource.RLIM_INFINITY and most < OPEN_FILES:
        text = f"a process may open {most} files here, and a link needs two; run: ulimit -n {OPEN_FILES}"
        return Finding("warning", "computer", text)
    return Finding("ok", "computer", "processes may open files enough")
