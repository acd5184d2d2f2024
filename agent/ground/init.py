"""`aucamp init`: a fleet file to begin with, with comments that say what to change."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import jinja2

from agent.core.config import Look, Pose
from agent.process.fleet_files import shipped_fleet
from agent.robot.fleet_reader import load_fleet

MOST = 10
FIRST_PORT = 17401
# More than the tank holds stand around the middle of a basin, far enough apart for hulls of 28 cm; see its scene.
BASIN_M, MIDDLE_M, RING_M = (2.4, 2.0, 0.8), (1.2, 1.0), 0.8
AWAY_DEG = 60.0  # of those that are to be told: no camera of ours sees so far to the side


class Row(NamedTuple):
    """One robot's table, as text."""

    name: str
    neighbours: str
    listen: str
    serial: str
    camera: str
    pose: str
    look: str
    calibration: str


def write_fleet(path: Path, count: int, twin: bool) -> list[str]:
    """Write the file of `count` robots, 1 to 10; returns lines that say what to type next."""
    path.write_text(fleet_text(path, count, twin), encoding="utf-8")
    load_fleet(path)  # whoever wrote it, it is read as any other
    robots = f"{count} robot{'s' if count > 1 else ''}"
    next_one = f"aucamp demo --fleet {path}" if twin else f"aucamp calibrate run {path} --robot r1"
    what = f"{robots} in the twin" if twin else f"{robots}; put in what is marked MEASURE and SURVEY"
    return [f"{path}: {what}. Next:", f"  aucamp check {path}", f"  {next_one}"]


def fleet_text(path: Path, count: int, twin: bool) -> str:
    """The content of a fleet file that has this path."""
    tank = load_fleet(shipped_fleet())
    in_tank = count <= len(tank.robot)
    places = [(robot.pose, robot.look) for robot in tank.robot.values()][:count] if in_tank else ring(count)
    template = resources.files("agent.ground").joinpath("fleet.toml.jinja").read_text(encoding="utf-8")
    environment = jinja2.Environment(trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, autoescape=False)
    return environment.from_string(template).render(
        file=path.name,
        name=fleet_name(path),
        count="one robot" if count == 1 else f"{count} robots",
        twin=twin,
        size_m=tank.tank.size_m if in_tank else BASIN_M,
        surface_m=tank.tank.surface_m,
        radius_m=next(iter(tank.target.values())).radius_m,
        robots=[row(k, places, twin) for k in range(count)],
        scene="tank" if in_tank else "basin",
    )


def row(k: int, places: Sequence[tuple[Pose, Look]], twin: bool) -> Row:
    """Robot number `k` of as many as there are places. Only in the twin somebody has to look away."""
    name, (pose, look) = f"r{k + 1}", places[k]
    return Row(
        name,
        ", ".join(f'"r{i + 1}"' for i in neighbours(k, len(places))),
        f"tcp/127.0.0.1:{FIRST_PORT + k}" if twin else f"tcp/192.168.7.{11 + k}:{FIRST_PORT}",
        f"twin:{name}" if twin else "/dev/ttyACM0",
        f"twin:{name}" if twin else "v4l2:/dev/video0",
        f"{{ x_m = {pose.x_m:.2f}, y_m = {pose.y_m:.2f}, yaw_deg = {pose.yaw_deg:.1f} }}",
        f"{{ pan_deg = {look.pan_deg if twin else 0.0:.1f}, tilt_deg = 0.0 }}",
        f"calibration/{name}.toml",
    )


def neighbours(k: int, count: int) -> list[int]:
    """All others of a few; of many the two on each side, over which any word comes to anybody."""
    near = {(k + step) % count for step in (-2, -1, 1, 2)} if count > 5 else set(range(count))
    return sorted(near - {k})


def ring(count: int) -> list[tuple[Pose, Look]]:
    """Around the middle of the basin, heading for it. The first looks at it, the others away, until they are told."""
    places = []
    for k in range(count):
        angle = 2.0 * math.pi * k / count
        x_m, y_m = MIDDLE_M[0] - RING_M * math.cos(angle), MIDDLE_M[1] - RING_M * math.sin(angle)
        look = Look(pan_deg=0.0 if k == 0 else AWAY_DEG if k % 2 else -AWAY_DEG)
        places.append((Pose(x_m=x_m, y_m=y_m, yaw_deg=math.degrees(angle)), look))
    return places


def fleet_name(path: Path) -> str:
    """The file's own name where a fleet can be called so: two fleets in the twin of one computer need two names."""
    name = re.sub(r"[^a-z0-9_]", "_", path.stem.lower())[:16]
    return name if re.match("[a-z]", name) else "fleet"
