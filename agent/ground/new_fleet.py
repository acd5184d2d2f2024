"""Files that a new fleet begins with: `aucamp init` writes a fleet file with comments that say what to change, `aucamp
keys` makes signing keys and certificates.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import jinja2

from agent.core.config import ConfigError, Fleet, Look, Pose, write_whole
from agent.process.certificates import (
    AUTHORITY,
    CERTIFICATE,
    CONSOLE_FILE,
    KEY,
    LEAF_DAYS,
    authority,
    certificate_file,
    key_file,
    new_authority,
    parties,
    write_certificates,
    write_console_file,
)
from agent.process.command import shipped_fleet
from agent.process.keys import PUBLIC, private_file, public_file, write_pair
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
    write_whole(path, fleet_text(path, count, twin))
    load_fleet(path)  # a file of ours is read as any other
    robots = f"{count} robot{'s' if count > 1 else ''}"
    typed = shlex.quote(str(path))
    next_one = f"aucamp demo --fleet {typed}" if twin else f"aucamp calibrate run {typed} --robot r1"
    what = f"{robots} in the twin" if twin else f"{robots}; put in what is marked MEASURE and SURVEY"
    return [f"{path}: {what}. Next:", f"  aucamp check {typed}", f"  {next_one}"]


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


# --- what is said of the files ---
# What `aucamp keys` says of the files that it made: whose each is, and what lies on which computer.


def where_to(fleet: Fleet, made: Sequence[Path], named: str) -> list[str]:
    """Lines: one a file, and what to do. `named`: the folder as the fleet file names it."""
    lines = [
        *(f"{file}: {_whose(file)}" for file in made),
        "",
        f"On each robot's computer these belong into the folder '{named}' beside its fleet file,",
        "or into the folder that the variable AUCAMP_KEYS names there:",
        "  its own NAME.sign, which nobody else may have or read, and the NAME.sign.pub of all.",
    ]
    if fleet.secured:
        lines[-1] = "  its own NAME.sign, NAME.key and NAME.pem, the NAME.sign.pub of all, and ca.pem."
        lines += [
            "On the computer of an observer or a console: its own NAME.key and NAME.pem, and ca.pem.",
            "The authority's ca.key goes nowhere: with it anybody's certificate can be made.",
        ]
    return [*lines, "Who has a private key can speak for its robot: keep no copy of it."]


def _whose(file: Path) -> str:
    if file.name == CONSOLE_FILE:
        return "for the program zenoh, on this computer"
    if file.name == f"{AUTHORITY}{KEY}":
        return "the authority's, to nobody: it stays where certificates are issued"
    if file.name == f"{AUTHORITY}{CERTIFICATE}":
        return "public, to everybody"
    if file.suffix == CERTIFICATE:
        return f"certificate, to {file.stem}"
    return "public, to every robot" if file.name.endswith(PUBLIC) else f"private, to {file.stem} alone"


# --- `aucamp keys` ---
# `aucamp keys`: signing keys, and certificates of a secured fleet; and in words what goes where.

FOLDER = "keys"  # beside the fleet file, where nothing else is said

EXISTS = (
    "exists, and keys are never overwritten; give --out a new folder, take --only for one that has none yet, or remove "
    "both files of a pair that is to be replaced"
)


def make_keys(robots: Iterable[str], folder: Path) -> list[Path]:
    """A signing pair for each of these robots; returns the files. Raises ConfigError before anything is written where
    one of them exists.
    """
    robots = list(robots)
    _refuse_any(path for name in robots for path in _signing(folder, name))
    return _all_or_nothing(folder, [partial(write_pair, folder, name) for name in robots])


def make_all(fleet: Fleet, folder: Path, days: float = LEAF_DAYS) -> list[Path]:
    """Signing keys of the robots, and in a secured fleet an authority and everybody's certificate. Raises ConfigError
    before anything is written where one of the files exists."""
    if not fleet.secured:
        return make_keys(fleet.robot, folder)
    names = parties(fleet)
    _refuse_any(path for name in fleet.robot for path in _signing(folder, name))
    _refuse_any(path for name in (AUTHORITY, *names) for path in _certificate(folder, name))
    _refuse_any([folder / CONSOLE_FILE])

    def certificates() -> list[Path]:
        ca, made = new_authority(fleet, folder)
        return [*made, *write_certificates(fleet, folder, names, days, ca), *write_console_file(fleet, folder)]

    return _all_or_nothing(folder, [*(partial(write_pair, folder, name) for name in fleet.robot), certificates])


def make_one(fleet: Fleet, folder: Path, name: str, path: Path, days: float = LEAF_DAYS) -> list[Path]:
    """What this party lacks: its signing pair, if it is a robot, and its certificate by the authority in the folder."""
    known = parties(fleet) if fleet.secured else list(fleet.robot)
    if name not in known:
        raise ConfigError(f"{path}: has no '{name}' to make keys for; it has {', '.join(known)}")
    makers: list[Callable[[], Iterable[Path]]] = []
    if name in fleet.robot and not any(file.exists() for file in _signing(folder, name)):
        makers.append(partial(write_pair, folder, name))
    if fleet.secured and not any(file.exists() for file in _certificate(folder, name)):
        makers.append(partial(write_certificates, fleet, folder, [name], days, authority(folder)))
    if not makers:
        _refuse_any((*_certificate(folder, name), *_signing(folder, name)))
    return _all_or_nothing(folder, makers)


def fleet_keys(fleet: Fleet, path: Path, out: Path, only: str | None = None, days: float = LEAF_DAYS) -> list[str]:
    """Make the keys of a fleet, or of one party of it; returns lines that say what to do with them."""
    made = make_all(fleet, out, days) if only is None else make_one(fleet, out, only, path, days)
    beside = out.resolve().parent == path.resolve().parent
    named = fleet.access.keys or (out.resolve().name if beside else FOLDER)
    lines = where_to(fleet, made, named)
    if fleet.access.keys is None:
        lines += ["", f"Every copy of {path.name} has to say so:", "", "[access]", f'keys = "{named}"']
    return lines


def _signing(folder: Path, name: str) -> tuple[Path, Path]:
    return private_file(folder, name), public_file(folder, name)


def _certificate(folder: Path, name: str) -> tuple[Path, Path]:
    return certificate_file(folder, name), key_file(folder, name)


def _refuse_any(paths: Iterable[Path]) -> None:
    for path in paths:
        if path.exists():
            raise ConfigError(f"{path}: {EXISTS}")


def _all_or_nothing(folder: Path, makers: Sequence[Callable[[], Iterable[Path]]]) -> list[Path]:
    """The files that all of these made; a part of a fleet's keys would be in the way of the next attempt."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: cannot be made ({error.strerror}); give --out another folder") from None
    before = set(folder.iterdir())
    try:
        return [path for make in makers for path in make()]
    except BaseException:
        for path in set(folder.iterdir()) - before:
            path.unlink()
        raise
