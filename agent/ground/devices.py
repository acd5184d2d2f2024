"""A robot's devices on this computer: whether they are there and may be opened. Nothing that runs is disturbed."""

from __future__ import annotations

import grp
import os
from collections.abc import Iterator
from pathlib import Path

from agent.core.config import ConfigError, Fleet
from agent.ground.finding import Finding, tried
from hw.camera.open import known_scheme, open_camera
from hw.camera.v4l2_node import find
from hw.twin.devices.twin_folder import twin_dir

BY_ID = Path("/dev/serial/by-id")  # udev's names, which stay the same


def device_findings(fleet: Fleet, name: str) -> Iterator[Finding]:
    """Control module and camera of one robot."""
    robot = fleet.robot[name]
    if robot.serial.startswith("twin:") and robot.camera.startswith("twin:"):
        yield Finding("ok", name, "control module and camera in the twin")
        return
    if not robot.serial.startswith("twin:"):
        yield tried(name, lambda: serial_port(Path(robot.serial)))
    yield tried(name, lambda: camera(fleet, name))


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
    if scheme == "twin":
        return f"{url} in the twin"
    open_camera(url, twin_dir(fleet), size).close()
    return f"{url} gives pictures of {size[0]}x{size[1]} pixels"
