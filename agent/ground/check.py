"""`aucamp check`: all that can be known of a fleet's start without starting anything, devices of this computer
included.
"""

from __future__ import annotations

import contextlib
import grp
import os
import stat
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from agent.core.config import ConfigError, Fleet, read_text, read_toml
from agent.ground.check_files import (
    Finding,
    Level,
    address_finding,
    calibration_findings,
    certificate_findings,
    copied_findings,
    disk_finding,
    enhancement_findings,
    files_finding,
    is_here,
    key_findings,
    liar_findings,
    links,
    loopback_findings,
    odd_findings,
    place_findings,
    target_findings,
    tried,
    twin_findings,
    unit_findings,
    watchers_here,
)
from agent.process.agent_process import own_calibration
from agent.robot.arbiter import broken_extend_rules, priorities
from agent.robot.fleet_reader import broken_rules, load_fleet, load_robot, read_fleet, two_worlds
from hw.camera import known_scheme, libcamera, open_camera
from hw.camera.camera import CameraError
from hw.camera.v4l2_node import find
from hw.stm32 import serial_port as module_port
from hw.twin.twin_folder import twin_dir

# --- devices of this computer ---
# A robot's devices on this computer: whether they are there and may be opened. Nothing that runs is disturbed.

BY_ID = Path("/dev/serial/by-id")  # udev's names, which stay the same


def device_findings(fleet: Fleet, name: str) -> Iterator[Finding]:
    """Control module and camera of one robot."""
    robot = fleet.robot[name]
    if robot.serial.startswith("twin:") and robot.camera.startswith("twin:"):
        yield Finding("ok", name, "control module and camera in the twin")
        return
    if not robot.serial.startswith("twin:"):
        yield tried(name, lambda: serial_port(Path(module_port(robot.serial, twin_dir(fleet)))))
    yield tried(name, lambda: camera(fleet, name))


def shared_findings(fleet: Fleet, names: Sequence[str]) -> Iterator[Finding]:
    """Devices that two robots of this computer have by two names: what a name leads to counts, not the name."""
    owner: dict[tuple[int, ...], tuple[str, str]] = {}
    for name in names:
        robot = fleet.robot[name]
        for key, text, place in (
            ("serial", robot.serial, robot.serial.removeprefix("stm32:")),
            ("camera", robot.camera, robot.camera.partition(":")[2]),
        ):
            thing = None if text.startswith("twin:") else identity(text, place)
            if thing is None:
                continue
            if thing in owner and owner[thing][1] != text:
                other, said = owner[thing]
                # Recorded pictures may be looked at by many.
                level: Level = "warning" if text.startswith(("video:", "stack:")) else "wrong"
                why = f"{key} '{text}' is also that of '{other}', which calls it '{said}'; give each robot its own"
                yield Finding(level, name, why)
            owner.setdefault(thing, (name, text))


def identity(text: str, place: str) -> tuple[int, ...] | None:
    """What the system knows a device or a file by, whatever leads to it; None: it is not there."""
    try:
        if text.startswith("v4l2:") and "/" not in place:
            device, _ = find(place)
            place = str(device.path)
            device.close()
        status = Path(place).stat()
    except (OSError, CameraError):
        return None
    return (status.st_rdev,) if stat.S_ISCHR(status.st_mode) else (status.st_dev, status.st_ino)


def serial_port(path: Path) -> str:
    """Looks at the port without opening it, which would take it from an agent. Raises ConfigError."""
    if not path.exists():
        there = sorted(str(link) for link in BY_ID.iterdir()) if BY_ID.is_dir() else []
        other = f"there is {', '.join(there)}" if there else "plug the control module in"
        raise ConfigError(f"{path}: no such serial port; {other}, and correct serial in the fleet file")
    if not path.is_char_device():
        raise ConfigError(f"{path}: no serial port; correct serial in the fleet file")
    if not os.access(path, os.R_OK | os.W_OK):
        raise ConfigError(
            f"{path}: you may not open it; join its group: sudo usermod -aG {group(path)} $USER, log in anew"
        )
    return f"{path} is there, and may be opened"


def group(path: Path) -> str:
    """Whose members may open a device; dialout where it is nobody's but root's."""
    try:
        owner = grp.getgrgid(path.stat().st_gid).gr_name
    except (KeyError, OSError):
        owner = "root"
    return "dialout" if owner == "root" else owner


def camera(fleet: Fleet, name: str) -> str:
    """A camera is asked who it is, which does not stop its pictures; recorded ones are opened. Raises CameraError."""
    url, size = fleet.robot[name].camera, (fleet.camera.width_px, fleet.camera.height_px)
    scheme, place = known_scheme(url)
    if scheme == "v4l2":
        device, who = find(place)
        device.close()
        return f"{url} is '{who.card}' at {device.path}"
    if scheme == "libcamera":
        return f"{url} is '{libcamera.find(place)[1]}'"
    if scheme == "twin":
        return f"{url} in the twin"
    open_camera(url, twin_dir(fleet), size, mains_hz=fleet.camera.mains_hz).close()
    return f"{url} gives pictures of {size[0]}x{size[1]} pixels"


# --- all that can be known before a start ---

OPEN = "open: who reaches a port can read it and speak as any robot; docs/access.md says how to secure it"
MARKS = ("MEASURE", "SURVEY")  # that `aucamp init` leaves in the comments of a file of real robots


class Checked(NamedTuple):
    """All findings, in the order in which they were made."""

    findings: tuple[Finding, ...]
    robots: int = 0  # of how many the devices and files were looked at: those of this computer

    @property
    def well(self) -> bool:
        return not any(finding.level == "wrong" for finding in self.findings)

    @property
    def verdict(self) -> str:
        """One line at the end."""
        counts = Counter(finding.level for finding in self.findings)
        warnings = f"; {counts['warning']} warning{'s' if counts['warning'] > 1 else ''}" if counts["warning"] else ""
        if not self.well:
            things = "one thing is" if counts["wrong"] == 1 else f"{counts['wrong']} things are"
            return f"not ready: {things} wrong{warnings}"
        return f"{'ready to start' if self.robots else 'nothing is wrong with the file'}{warnings}"

    def as_json(self) -> dict[str, Any]:
        """For programs."""
        about = {"well": self.well, "verdict": self.verdict, "robots": self.robots}
        return {**about, "findings": [finding._asdict() for finding in self.findings]}


def check(path: Path, robot: str | None, folder: Path) -> Checked:
    """Look at a fleet file and at this computer; of one robot alone if it is named. `folder`: where it would record.

    A mistake in the file is a finding. Raises ConfigError where there is no such file or robot.
    """
    if not path.is_file():
        read_toml(path)  # says so
    mistakes = tuple(mistakes_in(path))
    if mistakes:
        return Checked(mistakes)
    fleet = load_fleet(path)
    if robot is not None:
        load_robot(fleet, robot, path)
    here = [robot] if robot is not None else [name for name, one in fleet.robot.items() if is_here(one.listen)]
    found = [*fleet_findings(fleet, path)]
    for name in fleet.robot if robot is None else [robot]:
        found.append(address_finding(fleet, name, path, asked=robot is not None))
        found += robot_findings(fleet, name, path) if name in here else ()
    found += shared_findings(fleet, here if robot is None else [])
    found += copied_findings(fleet, here if robot is None else [], path)
    for name in watchers_here(fleet, path) if robot is None else ():
        found += certificate_findings(fleet, name, path)
    return Checked((*found, *computer_findings(here, folder)), len(here))


def mistakes_in(path: Path) -> Iterator[Finding]:
    """All rules that the file breaks, where it can be read at all; a person would rather not hear of one at a time.
    A number in another unit stands for all that its table breaks by it."""
    try:
        fleet = read_fleet(path)
    except ConfigError as error:
        yield Finding("wrong", "file", str(error))
        return
    broken = (*broken_rules(fleet), *broken_extend_rules(fleet))
    for odd in unit_findings(fleet) if broken else ():
        key, _, what = odd.text.partition(": ")
        table = key.rpartition(".")[0] + "."
        if any(one.startswith(table) for one, _ in broken):
            broken = tuple(one for one in broken if not one[0].startswith(table))
            yield Finding("wrong", "file", f"{path}: key '{key}': {what}")
    for key, remedy in broken:
        yield Finding("wrong", "file", f"{path}: key '{key}': {remedy}")
    try:
        priorities()
    except ConfigError as error:
        yield Finding("wrong", "code", str(error))


def fleet_findings(fleet: Fleet, path: Path) -> Iterator[Finding]:
    """What concerns all robots."""
    robots, targets = ", ".join(fleet.robot), ", ".join(fleet.target)
    yield Finding("ok", "file", f"{path}: fleet '{fleet.fleet}' of {robots}; they look for {targets}")
    marks = [mark for mark in MARKS if mark in read_text(path, "correct it")]
    if marks:
        text = f"{path}: still marked {' and '.join(marks)}; put in what is true of your tank, and take the marks out"
        yield Finding("warning", "file", text)
    if (why := two_worlds(fleet)) is not None:
        yield Finding("wrong", "fleet", why)
    yield from links(fleet)
    yield from loopback_findings(fleet)
    yield from twin_findings(fleet, path)
    yield from target_findings(fleet)
    yield from unit_findings(fleet)
    yield from place_findings(fleet)
    yield from liar_findings(fleet)
    yield from enhancement_findings(fleet)
    if fleet.access.keys is None:
        yield Finding("ok", "fleet", "signs nothing: [access] names no keys")
    if not fleet.secured:
        yield Finding("ok", "fleet", OPEN)


def robot_findings(fleet: Fleet, name: str, path: Path) -> Iterator[Finding]:
    """What a robot of this computer needs here."""
    yield from calibration_findings(fleet, name, path)
    yield from running_findings(fleet, name, path)


def running_findings(fleet: Fleet, name: str, path: Path) -> Iterator[Finding]:
    """What it needs to be here for as long as it runs."""
    yield from key_findings(fleet, name, path)
    yield from certificate_findings(fleet, name, path)
    yield from device_findings(fleet, name)


def computer_findings(here: Sequence[str], folder: Path) -> Iterator[Finding]:
    """What the computer has for the robots that are here."""
    if here:
        yield disk_finding(folder)
        yield files_finding()
    else:
        text = "no robot listens at an address of this computer: devices and files were not looked at"
        yield Finding("warning", "fleet", f"{text}; check on the robots' computers, or correct listen")


def before_dive(fleet: Fleet, name: str, path: Path, folder: Path) -> str | None:
    """What will go wrong in a dive of this robot though its agent starts, in one line; None: nothing is known to.
    `folder`: where it records."""
    found = [*running_findings(fleet, name, path), *computer_findings([name], folder)]
    with contextlib.suppress(ConfigError):  # without a calibration it does not start
        found = [*odd_findings(fleet, name, own_calibration(fleet, name, path)), *found]
    return "; ".join(finding.text for finding in found if finding.level != "ok") or None
